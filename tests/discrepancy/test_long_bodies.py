"""Laws of tendons and long bodies, and a rod in whose data one of them is hidden."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.tables import write_columns
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.laws.bodies import BODIES
from tepm_opt.discrepancy.laws.effect import At, Law
from tepm_opt.discrepancy.laws.tendons import TENDONS
from tepm_opt.jobs.discrepancy import run_discrepancy
from tests.discrepancy.test_callable_plant import run_of

LAWS = {law.name: law for law in (*TENDONS, *BODIES)}
SIGNAL, ALONG, TURNED = np.array([0.0, 1.0, 4.0]), np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.3, 2.0])
ROD = """
import numpy as np
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.callable_plant import Simulator
from tepm_opt.discrepancy.laws.bodies import BODIES
from tepm_opt.discrepancy.laws.rod import equilibrium
from tepm_opt.discrepancy.laws.tendons import TENDONS

ALONG = (np.arange(10) + 0.5) / 10
m = Simulator("a rod", Signals.from_names(["tension"], ["middle", "tip"], "m", axes=("x", "z")))
m.parameter("bend", 1.0, "1/(N m)", within=0.5)
m.parameter("weight", 20.0, "1/m2", within=0.5)
m.parameter("tilt", 0.0, "rad", std=0.1, groups=("a", "b"))
tendon = m.effects(TENDONS, "tension", "N", signal=8.0)
body = m.effects([law for law in BODIES if law.name == "stiffness_along"], "body")

def simulate(run, values):
    long = {name: value[:, None, None] for name, value in values.items()}
    tension, stiffness = run.inputs[None, :, :1], body(long, np.ones(10), along=ALONG)

    def pulls(turned):
        moment = long["bend"] * tendon(long, tension, turned=turned)
        return np.stack([0 * moment, moment])

    tilt = values["tilt"][:, None]
    steps = np.full((1, run.rows, 10), 0.03)
    rod = equilibrium(pulls, stiffness, long["weight"] / 10 + 0 * steps, steps, np.stack([0 * tilt, tilt, 0 * tilt]))
    found = [rod.point_at(np.full((1, run.rows), at), 0.0, 0.0)[::2] for at in (0.5, 1.0)]
    return np.moveaxis(found, (0, 1), (2, 3))

plant = m.plant(simulate, static=True, many=True)
"""


def acted(law: Law, p: Mapping[str, float], signal: Any = SIGNAL) -> np.ndarray:
    return np.asarray(law.act(At(p, [], {"signal": 4.0, "1": 1.0}, signal=signal, along=ALONG, turned=TURNED))[0])


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_at_its_null_a_law_leaves_the_signal(law: Law) -> None:
    candidate, free = law.place_on("there", {"signal": 4.0, "1": 1.0}, {"signal": "N", "1": "1"})
    assert np.array_equal(acted(law, {name: each.start for name, each in free.items()}), SIGNAL)
    assert candidate.explains
    for probe in candidate.probes:
        p = {name: probe[each.name] for name, each in free.items()}
        assert not np.array_equal(acted(law, p, 3 * SIGNAL), 3 * SIGNAL)
        assert all(each.low <= p[name] <= each.high for name, each in free.items())


@pytest.mark.parametrize(
    ("name", "p", "expected"),
    [
        ("tendon_slack", {"slack": 1.5}, [0, 0, 2.5]),
        ("tendon_stretch", {"share": 0.25}, [0, 0.75, 3]),
        ("tendon_slip", {"tightness": 2.0}, [0, 1, 2]),
        ("capstan_friction", {"friction": 0.2}, [0, np.exp(-0.06), 4 * np.exp(-0.4)]),
        ("radius", {"part": 0.1}, [0, 1.1, 4.4]),
        ("taper", {"part": 0.4}, [0, 0.8, 2.4]),
        ("stiffness_along", {"part": -0.5}, [0, 1.0, 3.0]),
        ("rest_length", {"part": -0.05}, [0, 0.95, 3.8]),
        ("rest_curvature", {"rate": 0.3}, [0.3, 1.3, 4.3]),
    ],
)
def test_what_laws_make_of_a_signal(name: str, p: dict[str, float], expected: list[float]) -> None:
    np.testing.assert_allclose(acted(LAWS[name], p), expected)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "value"),
    [
        ("", 0.0),
        ("tendon_slack[tension].slack", 1.2),
        ("capstan_friction[tension].friction", 0.4),
    ],
)
def test_what_is_hidden_in_a_rod_is_named(tmp_path: Path, hidden: str, value: float) -> None:
    file = tmp_path / "rod.py"
    file.write_text(ROD)
    made: dict[str, Any] = {}
    exec(ROD, made)
    truth = {"bend": 1.2, "weight": 24.0, "tilt[a]": 0.05, "tilt[b]": -0.08, **({hidden: value} if hidden else {})}
    plant, random, lines = made["plant"].with_values(truth), np.random.default_rng(2), []
    (tmp_path / "data").mkdir()
    for k, group in enumerate("ababab"):
        tension = np.linspace(0, 9, 60)[:, None] + 0.02 * k
        at = plant.predict(run_of(tension, np.zeros((60, 2, 2)), group)).points
        at = at + random.normal(0, 1e-4, at.shape)
        columns = {"tension": tension[:, 0]} | {
            f"{p}_{a}": at[:, i, j] for i, p in enumerate(("middle", "tip")) for j, a in enumerate("xz")
        }
        write_columns(tmp_path / "data" / f"{k}.csv", columns)
        lines.append(f'[[runs]]\nfile = "{k}.csv"\nrole = "{"validation" if k == 5 else "fit"}"\ngroup = "{group}"\n')
    noise = "middle = 1e-4\ntip = 1e-4\n"
    (tmp_path / "data" / "dataset.toml").write_text(f'name = "rod"\nstatic = true\n[noise]\n{noise}' + "".join(lines))
    verdict = run_discrepancy(tmp_path / "data", tmp_path / "out", plant=file).verdict
    if not hidden:
        assert verdict.status is VerdictStatus.NO_DISCREPANCY, verdict.paragraph
        assert verdict.recalibrated["tilt[b]"].value == pytest.approx(-0.08, abs=1e-3)
        return
    label, _, name = hidden.rpartition(".")
    assert [each.candidate.label for each in verdict.effects] == [label], verdict.paragraph
    assert verdict.effects[0].parameters[name].value == pytest.approx(value, rel=0.03)
