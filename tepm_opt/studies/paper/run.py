"""All experiments of the paper, one after the other, and the numbers they leave in a folder."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.tables import write_columns
from tepm_opt.errors import unknown_name
from tepm_opt.hw.simulation.rigfile import load_rig_file
from tepm_opt.models.compile import compile_model
from tepm_opt.progress import Progress, silent
from tepm_opt.studies.paper import gains, load, shapes, single, tracking
from tepm_opt.studies.paper.common import Clock, Setting
from tepm_opt.studies.paper.published import PUBLISHED, is_reproduced
from tepm_opt.studies.paper.result import ExperimentResult

QUICK_POINTS = 8  # of the circle


@dataclass(frozen=True)
class Experiment:
    """An experiment and how long it takes on the rig: seconds of virtual time, once and with every run, full and quick."""

    run: Callable[[Setting, bool], ExperimentResult]
    once: float
    a_run: float
    quick_run: float


def _points(quick: bool) -> int:
    return QUICK_POINTS if quick else 32


EXPERIMENTS: Mapping[str, Experiment] = {
    "table1": Experiment(lambda setting, quick: single.identification(setting), 90 / 8, 0.0, 0.0),
    "fig6": Experiment(lambda setting, quick: single.set_points(setting), 0.0, 36 / 8, 36 / 8),
    "fig7": Experiment(lambda setting, quick: shapes.elongation(setting), 0.0, 5.0, 5.0),
    "fig8": Experiment(lambda setting, quick: shapes.double_bend(setting), 0.0, 5.0, 5.0),
    "fig9": Experiment(lambda setting, quick: shapes.dynamic_bend(setting), 3.0, 3.0, 3.0),
    "fig10": Experiment(lambda setting, quick: load.run_load_experiment(setting), 20.0, 5.0, 5.0),
    "fig11": Experiment(lambda setting, quick: gains.open_loop_gain(setting), 24.0, 0.0, 0.0),
    "fig12": Experiment(lambda setting, quick: tracking.track_circle(setting, _points(quick)), 0.0, 198.0, 54.0),
}


def select_experiments(figures: Sequence[str]) -> list[str]:
    """Select the experiments asked for, in the paper's order; all where none is named.

    Raises:
        InputError: no such figure.
    """
    for name in figures:
        if name not in EXPERIMENTS:
            raise unknown_name("figure", name, EXPERIMENTS)
    return [name for name in EXPERIMENTS if not figures or name in figures]


def seconds(name: str, runs: int, quick: bool) -> float:
    """Virtual time in s that an experiment takes, for progress."""
    experiment = EXPERIMENTS[name]
    return experiment.once + runs * (experiment.quick_run if quick else experiment.a_run)


@dataclass(frozen=True, eq=False)
class Study:
    """Experiments that were finished.

    Attributes:
        setting: model and rig.
        results: in the paper's order.
        asked: names of the experiments asked for.
        quick: one run each and part of the circle.
        interrupted: whether the user ended it early.
    """

    setting: Setting
    results: list[ExperimentResult]
    asked: list[str]
    quick: bool
    interrupted: bool

    def rows(self) -> list[dict[str, Any]]:
        """A row for every published number of the finished experiments."""
        rows = []
        for result in self.results:
            for key, value in result.numbers.items():
                entry = PUBLISHED[key]
                row = {"key": key, "figure": entry.figure, "text": entry.text, "unit": entry.unit, "published": entry.value}
                rows.append({**row, "ours": value, "ratio": value / entry.value, "within": is_reproduced(key, value)})
        return sorted(rows, key=lambda row: list(PUBLISHED).index(row["key"]))

    def summary(self) -> dict[str, Any]:
        """Numbers of the study."""
        rows = self.rows()
        return {
            "rig": self.setting.rig.name,
            "robot": self.setting.model.robot.name,
            "runs": self.setting.runs,
            "quick": self.quick,
            "interrupted": self.interrupted,
            "finished": [result.figure for result in self.results],
            "numbers": len(rows),
            "within_15_percent": sum(row["within"] for row in rows),
            "rows": rows,
            "checks": [
                {"figure": result.figure, "text": text, "holds": bool(holds)}
                for result in self.results
                for text, holds in result.checks.items()
            ],
        }

    def save(self, folder: str | Path) -> None:
        """Write paper.json and the tables behind the figures (CSV).

        Raises:
            InputError: the folder cannot be written to.
        """
        folder = output_folder(folder)
        for result in self.results:
            for name, columns in result.tables.items():
                write_columns(folder / f"{name}.csv", columns)
        write_atomically(folder / "paper.json", json.dumps(self.summary(), indent=2, ensure_ascii=False) + "\n")

    def __repr__(self) -> str:
        how = "interrupted" if self.interrupted else "finished"
        return f"Study({how}: {', '.join(result.figure for result in self.results)}; runs={self.setting.runs}, quick={self.quick})"


def run_study(
    rig: str = "virtual_prototype",
    figures: Sequence[str] = (),
    quick: bool = False,
    progress: Progress = silent,
    finished: Callable[[Study], None] = lambda _: None,
    workers: int = 0,
) -> Study:
    """Run experiments on the virtual prototype and on the model.

    Args:
        rig: name of a built-in rig file or path of one.
        figures: names of `EXPERIMENTS`; all where empty.
        quick: one run each, part of the circle.
        progress: told the experiment's name and the virtual time in s that has passed.
        finished: called after every experiment with what there is.
        workers: processes for what takes longest; as many as there are processors where 0.

    Raises:
        InputError: no such figure, no such rig.
    """
    names = select_experiments(figures)
    file = load_rig_file(rig)
    runs, begun = 1 if quick else 3, 0.0
    clock = Clock(progress, sum(seconds(name, runs, quick) for name in names))
    setting = Setting(compile_model(file.robot), file, runs, clock, workers or os.cpu_count() or 1)
    study = Study(setting, [], names, quick, True)
    try:
        for name in names:
            clock.begin_experiment(name, begun)
            study = replace(study, results=[*study.results, EXPERIMENTS[name].run(setting, quick)])
            finished(study)
            begun += seconds(name, runs, quick)
    except KeyboardInterrupt:
        return study
    return replace(study, interrupted=False)
