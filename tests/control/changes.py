"""A simulated rig that changes while a loop is closed: twelve kinds of change, from one instant on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from tepm_opt.control.references.reference import Reference, approach, point_by_point, reference_of, sample_tips
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.engine import KINDS
from tepm_opt.hw.simulation.imperfections import ActuatorOffset, Imperfection, Payload, RegulatorLeak, TendonSlip
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.models.layout import Layout
from tepm_opt.solvers.planning.trajectories import circle, lissajous
from tests.control.study import APPROACH, PAUSE, model

PAYLOAD, WEAKER, STIFFER, ZERO, LEAK, SLIP, GAUGE, SHIFT, TILT = 0.030, 0.10, 0.05, 6e3, 0.05, 0.3, 0.3, 5e-3, 1.0
"""Sizes: kg, parts of strength and stiffness, Pa, part of the absolute pressure, part of the tension, N, m, degrees."""
NOTHING = 1e-12  # size of a stage that is there from the start and does nothing until it is changed


@dataclass(frozen=True)
class Change:
    """Something that happens to a rig.

    Attributes:
        number: of the actuator that it happens to, from 0, and `point`, of the tracked point.
        way: a direction of length 1, (3,).
        before: imperfections of the rig from the start on, given the actuator's name and the instant in s.
        act: what the instant does to the rig's machine.
        lie: what is read from the instant on; what was measured where absent.
        names: about which the loop may tell it, given the names of the actuator and of the point.
    """

    number: int
    point: int
    way: np.ndarray
    names: Callable[[str, str], tuple[str, ...]]
    before: Callable[[str, float], tuple[Imperfection, ...]] = lambda name, at: ()
    act: Callable[[Changing, Change], None] | None = None
    lie: Callable[[Sample, Change], Sample] | None = None


class Changing(SimulatedRig):
    """A rig to which a change happens at a time of the run in s; none where the change is absent. It runs on the compiled engine."""

    def __init__(self, file: RigFile, change: Change | None, at: float, seed: int) -> None:
        if change is not None:
            name = Layout.from_robot(file.nominal).actuator_names[change.number]
            file = file.model_copy(update={"imperfections": file.imperfections.replace_kinds(*change.before(name, at))})
        super().__init__(file)
        self.reseed(seed)
        self._change_at, self._what, self._done = at, change, False

    def read(self) -> Sample:
        """As of the rig, changed."""
        what = self._what
        if what is not None and not self._done and self.time >= self._change_at:
            self._done = True
            if what.act is not None:
                what.act(self, what)
        sample = super().read()
        return sample if what is None or what.lie is None or not self._done else what.lie(sample, what)

    def array(self, name: str) -> np.ndarray:
        """An array of the compiled network, which it goes by."""
        return self.machine.network._kept[name]  # type: ignore[attr-defined]

    def stage(self, kind: str) -> np.ndarray:
        """Numbers of the stage of a kind: scalars, then a number a channel, then its state."""
        for group, stages in self.machine.network._groups.items():  # type: ignore[attr-defined]
            for k, stage in enumerate(stages):
                if KINDS[stage.kind] == kind:
                    return self.array(f"{group} {k}")
        raise LookupError(kind)


def _loaded(rig: Changing, mass: float) -> None:
    inverse, last = rig.array("inverse_mass"), rig.layout.levels - 1
    inverse[:, last] = 1 / (1 / inverse[:, last] + mass / rig.layout.actuators)


def _weaken(rig: Changing, change: Change) -> None:
    rig.stage("gain")[change.number] *= 1 - WEAKER


def _stiffen(rig: Changing, change: Change) -> None:
    module, muscle = divmod(change.number, rig.layout.actuators)
    levels = slice(module * rig.layout.segments, (module + 1) * rig.layout.segments)
    for name in ("stiffness", "preload"):
        rig.array(name)[muscle, levels] *= 1 + STIFFER


def _shift_zero(rig: Changing, change: Change) -> None:
    rig.stage("shift")[change.number] += ZERO


def _let_leak(rig: Changing, change: Change) -> None:
    rig.stage("leak")[2 + change.number] = LEAK


def _slow(rig: Changing, change: Change) -> None:
    """Half as fast: a lag as long as its own on the mean of filling and exhausting."""
    lag = rig.file.imperfections.regulator_lag
    rig.stage("leak")[0] = (lag.fill_s + lag.exhaust_s) / 2


def _rub(rig: Changing, change: Change) -> None:
    rig.stage("sheath")[:2] *= 2


def _tilt(rig: Changing, change: Change) -> None:
    turn = Rotation.from_rotvec(np.deg2rad(TILT) * np.array([*change.way[:2], 0.0]) / np.linalg.norm(change.way[:2])).as_matrix()
    for name in ("fall", "free_fall"):
        rig.array(name)[:] = turn.T @ rig.array(name)


def _misread(sample: Sample, change: Change) -> Sample:
    tensions = np.array(sample.tensions)
    tensions[change.number] += GAUGE
    return replace(sample, tensions=tensions)


def _slipped(sample: Sample, change: Change) -> Sample:
    points = sample.points.copy()
    points[change.point] += SHIFT * change.way
    return replace(sample, points=points)


def _leaky(name: str, at: float) -> tuple[Imperfection, ...]:
    return (RegulatorLeak(share={name: NOTHING}),)


def change_of(kind: str, random: np.random.Generator) -> Change:
    """A change of a kind, of what chance picks."""
    way = random.standard_normal(3)
    where = int(random.integers(6)), int(random.integers(4)), way / np.linalg.norm(way)
    return {
        "payload on": lambda: Change(*where, lambda *_: ("payload put on",), act=lambda rig, _: _loaded(rig, PAYLOAD)),
        "payload off": lambda: Change(
            *where, lambda *_: ("payload taken off",), lambda *_: (Payload(mass_kg=PAYLOAD),), lambda rig, _: _loaded(rig, -PAYLOAD)
        ),
        "muscle weaker": lambda: Change(*where, lambda name, _: (f"strength {name}",), act=_weaken),
        "muscle stiffer": lambda: Change(*where, lambda name, _: (f"stiffness {name}",), act=_stiffen),
        "regulator zero": lambda: Change(
            *where, lambda name, _: (f"pressure monitor {name}",), lambda name, at: (ActuatorOffset(zero_Pa={name: NOTHING}),), _shift_zero
        ),
        "regulator leaks": lambda: Change(*where, lambda name, _: (f"leak {name}",), _leaky, _let_leak),
        "regulator slower": lambda: Change(*where, lambda name, _: (f"lag {name}",), _leaky, _slow),
        "tendon slips": lambda: Change(
            *where, lambda name, _: (f"tendon {name}",), lambda name, at: (TendonSlip(share={name: SLIP}, instant_s=at),)
        ),
        "tendon friction": lambda: Change(*where, lambda *_: ("tendon friction",), act=_rub),
        "dynamometer": lambda: Change(*where, lambda name, _: (f"dynamometer {name}",), lie=_misread),
        "tracked point": lambda: Change(*where, lambda _, point: (f"marker {point}",), lie=_slipped),
        "base tilts": lambda: Change(*where, lambda *_: ("base tilt",), act=_tilt),
    }[kind]()  # fmt: skip


KINDS_OF_CHANGE = (
    "payload on", "payload off", "muscle weaker", "muscle stiffer", "regulator zero", "regulator leaks", "regulator slower", "tendon slips",
    "tendon friction", "dynamometer", "tracked point", "base tilts",
)  # fmt: skip
TASKS = ("circle", "lissajous", "points")
LENGTH = 40.0  # s, of a run about


@lru_cache(maxsize=4)
def path(task: str, length: float = LENGTH) -> Reference:
    """Laps of a path or point after point for about a time in s, from rest."""
    if task == "points":
        corners = circle(4).positions
        count = int((length - APPROACH) / 3.0)
        tips, *_ = point_by_point(corners[np.arange(count) % len(corners)], 1.0, 3.0, 1.0)
    else:
        shape = circle(400) if task == "circle" else lissajous(400)
        lap = 8.0 if task == "circle" else 6.0
        tips, _ = sample_tips(shape, laps=float(round((length - APPROACH - PAUSE) / lap)))
    lead = approach(model(), tips[0], APPROACH)
    lead = np.vstack([lead, np.repeat(tips[:1], round(PAUSE / 0.01), axis=0)])
    return reference_of(model(), np.vstack([lead, tips]))
