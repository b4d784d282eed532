"""Whether changes of the machine are told: `python -m tests.control.study_monitor SEED MACHINES [QUIET]` prints a table.

Every kind of change hits each of some random machines once, in turns on the circle, the lissajous and from point to point, between 15 and
20 s after the loop was closed; `QUIET` machines are driven without a change besides, for false alarms. Time and
evidence before a change count for these, too.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import numpy as np

from tepm_opt.control.diagnostics.monitor import EVIDENCE, Watched, attach_monitor
from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.family import random_machine
from tests.control.changes import KINDS_OF_CHANGE, TASKS, Changing, change_of, path
from tests.control.study import model

EARLIEST, LATEST, SOON = 15.0, 20.0, 20.0  # s: when it happens, and for how long it may be told
ENOUGH = 9.0  # s after a change was told, when its name stands


@dataclass(frozen=True)
class Found:
    """What was told in a run.

    Attributes:
        machine, kind, task: what was run.
        true: names of the true cause.
        monitor: times in s after the change, name and probability of what the monitor told.
        before: the same, told before it: false alarms.
        doubts: times in s after the change of the controller's own doubts, by what they are about.
        quiet: largest evidence before the change, `after` it, and `seconds` of the run without a change.
    """

    machine: int
    kind: str
    task: str
    true: tuple[str, ...]
    monitor: list[tuple[float, str, float]]
    before: list[tuple[float, str, float]]
    doubts: dict[str, float]
    quiet: float
    after: float
    seconds: float

    @property
    def delay(self) -> float:
        """Time in s from the change to when it was told by anybody; infinite where nobody did."""
        others = [at for about, at in self.doubts.items() if about in self.true]
        return min([at for at, *_ in self.monitor if at <= SOON] + others, default=np.inf)

    @property
    def named(self) -> bool:
        """Whether the first that was told has the right name, or the controller's own doubt has it."""
        return any(about in self.true for about in self.doubts) or (bool(self.monitor) and self.monitor[0][1] in self.true)


def driven(seed: int, machine: int, k: int, kind: str) -> Found:
    """A run: a kind of change on a machine of a family, the `k`-th of its kinds."""
    random = np.random.default_rng([seed, machine, k])
    file, task, at = random_machine("kang2017", seed, machine), TASKS[(machine + k) % len(TASKS)], float(random.uniform(EARLIEST, LATEST))
    change = change_of(kind, random) if kind else None
    controller = attach_monitor(Mpc(model(), path(task)), model())
    assert isinstance(controller, Watched)
    changes = controller.monitor.changes

    def enough(sample: Sample, target: np.ndarray) -> None:
        if change and changes and changes[-1].told >= at and sample.time > changes[-1].told + ENOUGH:
            raise EOFError("told and named")

    done = close_loop(Changing(file, change, at, 1 + k), controller, model().robot, observer=enough)
    first: dict[str, float] = {}
    for now, row in zip(done.time, done.telemetry, strict=True):
        for about in row.doubts:
            first.setdefault(about, now)
    at = at if change else np.inf
    told = [(each.told - at if change else each.told, *next(iter(each.probabilities.items()))) for each in controller.monitor.changes]
    layout, evidence, when = model().layout, np.array([float(row.columns[EVIDENCE]) for row in done.telemetry]), np.array(done.time)
    return Found(
        machine, kind, task, change.names(layout.actuator_names[change.number], layout.point_names[change.point]) if change else (),
        [each for each in told if change and each[0] >= 0], [each for each in told if not change or each[0] < 0],
        {about: now - at for about, now in first.items() if change and now >= at and not about.startswith("machine")},
        float(evidence[when < at].max()), float(evidence[when >= at].max(initial=0.0)), float(min(at, when[-1])),
    )  # fmt: skip


def line(found: Found) -> str:
    """A run in a line."""
    told = "; ".join(f"{at:.1f} s {name} {part:.2f}" for at, name, part in found.before + found.monitor)
    other = {about: round(at, 1) for about, at in found.doubts.items()}
    named = "named" if found.named else "not named"
    about = f"{found.machine} {found.kind or 'nothing'} {found.task}"
    return f"{about} | {named} | {told} | {other} | {found.quiet:.1f} {found.after:.1f}"


def table(seed: int, machines: int, quiet: int, kinds: tuple[str, ...] = KINDS_OF_CHANGE) -> list[Found]:
    """Drive all runs, with a line for each, and print what was found of each kind, and false alarms."""
    every = []
    for machine in range(max(machines, quiet)):
        chosen = [(k, kind) for k, kind in enumerate(kinds, 1) if machine < machines] + [(0, "")] * (machine < quiet)
        for k, kind in chosen:
            every.append(driven(seed, machine, k, kind))
            print(line(every[-1]), flush=True)
    for kind in (*kinds, ""):
        runs = [run for run in every if run.kind and kind in ("", run.kind)]
        if runs:
            delays, named = np.array([run.delay for run in runs]), np.mean([run.named for run in runs])
            found = np.isfinite(delays)
            print(f"{kind or 'all':18s} found {found.mean():4.0%} named {named:4.0%} median {np.median(delays):5.1f} s")
    alarms, hours = sum(len(run.before) for run in every), sum(run.seconds for run in every) / 3600
    largest = sorted(run.quiet for run in every)[-5:]
    print(f"without a change: {alarms} false alarms in {hours:.2f} h; largest evidence of the runs {np.round(largest, 1).tolist()}")
    return every


if __name__ == "__main__":
    began = time.time()
    table(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else int(sys.argv[2]))
    print(f"{time.time() - began:.0f} s")
