"""A small rig with the columns of kang2017: bends and stretches with a first-order lag, noise of 0.3 mm, 100 samples a second."""

from __future__ import annotations

import os
import time
from pathlib import Path
from types import TracebackType

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.robot import load_robot
from tepm_opt.progress import Progress
from tests.data.made import shape

ROBOT = load_robot("kang2017")
PERIOD, LAG = 0.01, 0.15


class FakeRig:
    """Virtual time, but no set points in advance: it has to be approached slowly, as hardware.

    Attributes:
        robot: kang2017.
        applied: every command, (inputs,) each, with its time.
        stops: how often it was stopped.
    """

    robot, simulated = ROBOT, None

    def __init__(self, seed: int = 0, measures: bool = True, wait: float = 0.0, noise: float = 3e-4) -> None:
        self.random = np.random.default_rng(seed)
        self.measures, self.wait, self.noise = measures, wait, noise
        self.ticks, self.stops = 0, 0
        self.commanded = np.zeros(12)
        self.state = np.zeros(12)
        self.applied: list[tuple[float, np.ndarray]] = []
        self.lose: dict[int, int] = {}  # tick: point that the tracker loses
        self.fail_at: dict[int, BaseException] = {}
        self.gaps: dict[int, int] = {}  # tick: how many more pass unseen
        self.wrong_from: float = np.inf  # tick from which on pressures are measured as ...
        self.wrong: np.ndarray | None = None

    @property
    def time(self) -> float:
        """Of the last sample in s."""
        return self.ticks * PERIOD

    def read(self) -> Sample:
        if self.wait:
            time.sleep(self.wait)
        if self.ticks in self.fail_at:
            raise self.fail_at[self.ticks]
        ticks = 1 + self.gaps.get(self.ticks, 0)
        self.state += (1 - np.exp(-ticks * PERIOD / LAG)) * (self.commanded - self.state)
        points = shape(self.state) + self.noise * self.random.normal(size=(4, 3))
        status = "ok"
        if self.ticks in self.lose:
            points[self.lose[self.ticks]] = np.nan
            status = f"lost s{self.lose[self.ticks] + 1}, see log"
        self.ticks += ticks
        pressures = self.state[:6] + 100 * self.random.normal(size=6) if self.measures else None
        pressures = self.wrong if self.ticks > self.wrong_from else pressures
        return Sample(self.ticks * PERIOD, points, pressures, status=status, extra={"supply_Pa": 6e5 + self.ticks} if self.measures else {})

    def apply(self, command: Command) -> None:
        values = np.concatenate([command.pressures, command.tensions])
        if not np.all((values >= 0) & (values <= ROBOT.input_max)):
            raise InputError(f"command {values}")
        self.commanded = values.copy()
        self.applied.append((self.ticks * PERIOD, self.commanded))

    def stop(self) -> None:
        self.stops += 1
        self.commanded = np.zeros(12)

    def __enter__(self) -> FakeRig:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()


def record_slowly(plan: str, out: str, log: str, wait: float) -> None:
    """`tepm record` on this rig, for processes that are killed.

    Before every read `log` gets a line with the run, the stage, and how far it is in s: by then all earlier rows have to be in the journal.
    """
    from tepm_opt.cli import rigs, run
    from tepm_opt.recording import drive

    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    plain = drive.Driver.__init__

    def logging(self: drive.Driver, rig: object, channels: object, progress: Progress) -> None:
        def tell(stage: str, done: float, of: float) -> None:
            os.write(handle, f"{stage},{done!r}\n".encode())

        plain(self, rig, channels, tell)  # type: ignore[arg-type]

    drive.Driver.__init__ = logging  # type: ignore[method-assign]
    rigs.open_rig = lambda text, robot: FakeRig(wait=wait)  # type: ignore[assignment,return-value]
    raise SystemExit(run(["record", plan, "--out", out, "--rig", "fake", "--json"]))


class FakeSimulation(FakeRig):
    """Takes seed, set points in advance and pushes as a simulated rig does, and rests from the start under what it is told first.

    Attributes:
        pushed: last, (3,) in N.
        scheduled: last, and the time in s from which on it is followed.
    """

    def __init__(self, seed: int = 0, noise: float = 3e-4) -> None:
        super().__init__(seed, noise=noise)
        self.pushed = np.zeros(3)
        self.scheduled: tuple[float, SetPoints] | None = None

    @property
    def simulated(self) -> FakeSimulation:  # type: ignore[override]
        return self

    def read_many(self, count: int) -> list[Sample]:
        return [self.read()]

    def reseed(self, noise: int, began: float = 0.0) -> None:
        self.random = np.random.default_rng(noise)

    def apply(self, command: Command) -> None:
        super().apply(command)
        self.scheduled = None
        self.state = self.commanded.copy() if self.ticks == 0 else self.state

    def schedule(self, setpoints: SetPoints, linear: bool = True) -> None:
        assert linear
        self.scheduled = (self.time, setpoints)

    def push(self, forces: np.ndarray) -> None:
        self.pushed = np.asarray(forces)

    def read(self) -> Sample:
        if self.scheduled is not None:
            start, points = self.scheduled
            self.commanded = np.array([np.interp(self.time - start, points.time, column) for column in points.inputs.T])
        return super().read()

    @property
    def true_points(self) -> np.ndarray:
        return shape(self.state)

    @property
    def true_nodes(self) -> np.ndarray:
        return np.tile(self.true_points[:, None], (1, 3, 1))

    @property
    def true_lengths(self) -> np.ndarray:
        return np.full(6, np.nan)


def plan_text(*runs: str, rate: int = 50) -> str:
    """A plan with these tables of runs."""
    return "\n".join([f'name = "fake"\nsample_rate_hz = {rate}', *(f"[[runs]]\n{run}" for run in runs)]) + "\n"


STEPS = (
    'file = "steps.csv"\nrole = "fit"\npattern = "steps"\nrest = {pressure_Pa = 1e5}\n'
    "levels = [{pressure_11_Pa = 2e5}, {tension_13_N = 3}]\nhold_s = 1\nrest_s = 1"
)
RAMP = (
    'file = "ramp.csv"\nrole = "validation"\npattern = "steps"\n'
    "levels = [{pressure_1_Pa = 2e5, tension_23_N = 2}]\nrise_s = 1\nhold_s = 0.5\nrest_s = 0.5"
)
SWEEP = (
    'file = "sweep.csv"\nrole = "fit"\npattern = "sweep"\nrest = {pressure_Pa = 1e5}\n'
    "amplitudes = [{pressure_12_Pa = 5e4}]\nduration_s = 3\nfrom_hz = 0.5"
)


def write_plan(folder: Path, *runs: str, rate: int = 50) -> Path:
    """A plan file in the folder."""
    path = folder / "plan.toml"
    path.write_text(plan_text(*(runs or (STEPS, RAMP, SWEEP)), rate=rate))
    return path
