"""Contents of a blind trial, and its label."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tepm_opt.studies.blind.causes import OTHER_MEANING, Form
from tepm_opt.studies.blind.engine_causes import OTHER_MEANING_IN_MUJOCO
from tepm_opt.studies.blind.flaws import Flaw
from tepm_opt.studies.blind.machine import Deviation
from tepm_opt.studies.blind.sizes import Pilot


@dataclass(frozen=True, eq=False)
class Hidden:
    """A cause that is hidden in a trial.

    Attributes:
        key: in its table.
        form: of the cause.
        size: of the form.
        misfit: that it leaves alone after recalibration, over the noise.
    """

    key: str
    form: Form
    size: float
    misfit: float


@dataclass(frozen=True, eq=False)
class Experiment:
    """Hidden causes and the data in which they hide.

    Attributes:
        pilot: runs of the machine without what is hidden.
        kind: of what is hidden, for the label.
        causes: what is hidden.
        flaw: what is wrong with the data.
        flaw_key: its name; empty where nothing is.
        declared: noise that the data set states, over the true one.
    """

    pilot: Pilot
    kind: str
    causes: tuple[Hidden, ...] = ()
    flaw: Flaw = field(default_factory=Flaw)
    flaw_key: str = ""
    declared: float = 1.0


def find_other_meaning(causes: Sequence[Hidden]) -> set[str]:
    """Parameters of the robot that do not mean the same beside causes of another form than the library's."""
    return {name for cause in causes for name in (OTHER_MEANING | OTHER_MEANING_IN_MUJOCO).get(cause.key, ())}


def describe(experiment: Experiment, machine: Deviation, acting: np.ndarray) -> dict[str, Any]:
    """Label of a trial: plain data with the keys of the labels of shared data sets, and more."""
    pilot, causes = experiment.pilot, experiment.causes
    values = pilot.robot.parameters.model_dump()
    label = {
        "names": sorted({name for cause in causes for name in cause.form.names}),
        "allowed": sorted({name for cause in causes for name in cause.form.allowed}),
        "alike": {name: alike for cause in causes for name in cause.form.names if (alike := cause.form.alike(pilot.runs, acting.tolist()))},
        "detail": {name: detail for cause in causes for name, detail in cause.form.detail.items()},
        "kind": experiment.kind,
        "flaw": experiment.flaw_key,
        "causes": [{"cause": c.key, "names": c.form.names, "size": float(c.size), "misfit_over_noise": round(c.misfit, 4)} for c in causes],
        "sizes": {name: size for cause in causes for name, size in cause.form.sizes(cause.size).items()},
        "true_parameters": {name: values[name] * factor for name, factor in machine.factors.items()},
        "other_meaning": sorted(set(pilot.robot.priors) if experiment.kind == "foreign" else find_other_meaning(causes)),
        "noise_m": pilot.noise,
        "declared_over_true_noise": experiment.declared,
        "files": {run.file: run.role for run in pilot.runs},
        "seconds": round(float(sum(run.setpoints.time[-1] for run in pilot.runs)), 1),
    }
    if not acting.all():
        label["runs"] = [run.file.removesuffix(".csv") for run, acts in zip(pilot.runs, acting, strict=True) if acts]
    return label
