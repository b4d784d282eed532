"""What lies or fails while the circle is driven: `python -m tests.control.study_attacks SEED MACHINES [WHAT …]` prints a line for each.

Every attack hits the virtual prototype and some random machines, with two noises: the true tip's error in mm rms beside that without it,
what was told and how soon after it began. Attacks that begin late begin with the path's second second. Then the disturbances of a
held point on random machines (`disturbances`): whether the true tip is back within 2 mm (4 mm without its sensor) in 3 s.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.control.loop import Guard, LoopRecord, close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tests.control.study import APPROACH, DISTURBANCES, PAUSE, WIDE, disturbed, model, reference

NOISES = (1, 2)
LATER = APPROACH + PAUSE + 2.0  # s, when something begins that does not begin with the run

Lie = Callable[[Sample, float, np.random.Generator], Sample]
"""A sample as the controller gets it: of what was measured, the time in s since the lie began, and a source of chance."""


@dataclass(frozen=True)
class Attack:
    """Something that is not as the robot file says.

    Attributes:
        file: the rig with it; the rig as it is where absent.
        lie: what is read instead; what was read where absent.
        begins: at which time of the run in s.
        guard: of the closed loop; the usual one where absent.
    """

    file: Callable[[RigFile], RigFile] | None = None
    lie: Lie | None = None
    begins: float = 0.0
    guard: Guard | None = None


class Lying(SimulatedRig):
    """A rig whose samples are changed from some time on."""

    def __init__(self, file: RigFile, attack: Attack, seed: int) -> None:
        super().__init__(attack.file(file) if attack.file else file)
        self.reseed(seed)
        self._attack, self._chance = attack, np.random.default_rng(seed)

    def read(self) -> Sample:
        """As of the rig, changed."""
        sample, since = super().read(), self.time - self._attack.begins
        return sample if self._attack.lie is None or since < 0 else self._attack.lie(sample, since, self._chance)


def _gauges(**parts: object) -> Callable[[RigFile], RigFile]:
    """A rig file with other values of its gauges: `dynamometer=…`, `tracker=…`, each a dict."""
    return lambda file: file.model_copy(update={name: getattr(file, name).model_copy(update=values) for name, values in parts.items()})


def _late(by: float) -> Callable[[RigFile], RigFile]:
    def changed(file: RigFile) -> RigFile:
        found = file.imperfections
        delay = found.time_delay.model_copy(update={"delay_s": found.time_delay.delay_s + by})
        return file.model_copy(update={"imperfections": found.model_copy(update={"time_delay": delay})})

    return changed


def _noisy(file: RigFile) -> RigFile:
    return file.model_copy(update={"tracker": file.tracker.model_copy(update={"noise_rms_m": 3 * file.tracker.noise_rms_m})})


def _tensions(change: Callable[[np.ndarray, float, np.random.Generator], np.ndarray]) -> Lie:
    return lambda sample, since, random: replace(sample, tensions=change(np.asarray(sample.tensions).copy(), since, random))


def _points(change: Callable[[np.ndarray, float, np.random.Generator], np.ndarray]) -> Lie:
    return lambda sample, since, random: replace(sample, points=change(sample.points.copy(), since, random))


def _stuck(tensions: np.ndarray, since: float, random: np.random.Generator) -> np.ndarray:
    tensions[2] = 3.5
    return tensions


def _slipped(which: int, by: tuple[float, float, float]) -> Lie:
    def changed(points: np.ndarray, since: float, random: np.random.Generator) -> np.ndarray:
        points[which] += by
        return points

    return _points(changed)


def _tipless(points: np.ndarray, since: float, random: np.random.Generator) -> np.ndarray:
    points[-1] = np.nan
    return points


ATTACKS: dict[str, Attack] = {
    "nothing": Attack(),
    "dynamometers 0.4 N low": Attack(_gauges(dynamometer={"offset_N": -0.4})),
    "dynamometers 1 N low": Attack(_gauges(dynamometer={"offset_N": -1.0})),
    "dynamometers read 0.9": Attack(lie=_tensions(lambda tensions, *_: 0.9 * tensions), begins=LATER),
    "dynamometers read 0": Attack(lie=_tensions(lambda tensions, *_: 0 * tensions), begins=LATER),
    "dynamometer 13 stuck": Attack(lie=_tensions(_stuck), begins=LATER),
    "dynamometers drift 0.1 N/s": Attack(lie=_tensions(lambda tensions, since, _: tensions + 0.1 * since), begins=LATER),
    "dynamometers NaN half the time": Attack(
        lie=_tensions(lambda tensions, since, random: np.where(random.random(len(tensions)) < 0.5, np.nan, tensions)), begins=LATER
    ),
    "monitors 20 kPa high": Attack(_gauges(pressure_monitor={"offset_Pa": 2e4})),
    "tracker noise x 3": Attack(_noisy),
    "commands 20 ms late": Attack(_late(0.020)),
    "commands 40 ms late": Attack(_late(0.040)),
    "tip point slips 5 mm": Attack(lie=_slipped(-1, (5e-3, 0.0, 0.0)), begins=LATER),
    "tip point slips 3 mm": Attack(lie=_slipped(-1, (3e-3, 0.0, 0.0)), begins=LATER),
    "point s2 slips 10 mm": Attack(lie=_slipped(1, (0.0, 1e-2, 0.0)), begins=LATER),
    "tip point lost half the time": Attack(
        lie=_points(lambda points, since, random: np.where((np.arange(len(points)) == len(points) - 1)[:, None] & (random.random() < 0.5),
                                                           np.nan, points)), begins=LATER),
    "tip point lost": Attack(lie=_points(_tipless), begins=LATER, guard=WIDE),
}  # fmt: skip


def attacked(file: RigFile, attack: Attack, seed: int) -> LoopRecord:
    """The circle on a rig."""
    return close_loop(Lying(file, attack, seed), Mpc(model(), reference("circle")), model().robot, attack.guard)


def told(done: LoopRecord, begins: float) -> tuple[str, float]:
    """What was told first, by what it is about, and how soon in s; empty and infinite for silence."""
    for time, row in zip(done.time, done.telemetry, strict=True):
        if row.doubts:
            kinds = sorted({about.rsplit(" ", 1)[0] if about[-1].isdigit() else about for about in row.doubts})
            return ", ".join(kinds), time - begins
    return "", np.inf


def attacks(seed: int, machines: int, whats: Sequence[str]) -> None:
    """Print a line for every attack: errors by machine, how often it was told, how soon at the latest."""
    files = [load_rig_file(), *(random_machine("kang2017", seed, number) for number in range(machines))]
    plain: np.ndarray | None = None
    for what in ("nothing", *(name for name in whats if name != "nothing")):
        attack = ATTACKS[what]
        done = [[attacked(file, attack, noise) for noise in NOISES] for file in files]
        errors = np.array([[1e3 * run.error() for run in runs] for runs in done])
        early = sum(not run.outcome.solved for runs in done for run in runs)
        plain = errors if plain is None else plain
        found = [told(run, attack.begins) for runs in done for run in runs]
        said, soon = sorted({text for text, _ in found if text}), [time for _, time in found if np.isfinite(time)]
        silent = sum(not text and bad > 2 for (text, _), bad in zip(found, (errors / plain).ravel(), strict=True))
        print(
            f"{what:32s} {np.round(errors.mean(axis=1), 2)} worst {errors.max():.2f} x {(errors / plain).max():.2f} "
            f"told {len(soon)}/{len(found)} after {max(soon, default=np.nan):.2f} s, early {early}, silent and doubled {silent}: {said}",
            flush=True,
        )


def disturbances(seed: int, machines: int, whats: Sequence[str]) -> None:
    """Print a line for every disturbance of a held point: the largest error from 3 s after it by machine."""
    for what in whats:
        found = [disturbed(what, 1, file=random_machine("kang2017", seed, number)) for number in range(machines)]
        after, rms = np.array([row["after"] for row in found]), np.array([row["rms_after"] for row in found])
        within = float((after <= (4.0 if what.startswith("dead") else 2.0)).mean())
        worst = max(row["worst"] for row in found)
        text = f"within {within:.0%}, after 3 s worst {after.max():.2f}, rms {rms.mean():.2f}, peak {worst:.1f}"
        print(f"{what:10s} {text} | {np.round(after, 2).tolist()}", flush=True)


if __name__ == "__main__":
    family, count, chosen = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
    if chosen[:1] == ["disturbances"]:
        disturbances(family, count, chosen[1:] or DISTURBANCES)
    else:
        attacks(family, count, chosen or tuple(ATTACKS))
