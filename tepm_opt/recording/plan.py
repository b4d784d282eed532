"""Recording plans: which runs to record, in which roles, under which inputs (TOML). `docs/how-to/recording.md` describes the file."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from tepm_opt.data.documents import Section, read_toml, require_range, validate
from tepm_opt.data.run import Role, Run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.models.robot import Robot, builtin_robots, load_robot
from tepm_opt.recording.patterns import PATTERNS, FileRun, PatternContext, RunPlan


class _PlanFile(Section):
    name: Annotated[str, Field(min_length=1, description="any text")]
    robot: Annotated[str, Field(min_length=1, description="a built-in robot or the path of a robot file")] = "kang2017"
    sample_rate_hz: Annotated[float, require_range(1, 1e4, "Hz")] = 50.0
    position_noise_m: Annotated[float, require_range(0, 0.1, "m, 1 sigma per axis")] | None = None
    runs: Annotated[list[dict[str, Any]], Field(min_length=1, description="at least one [[runs]]")]


@dataclass(frozen=True, eq=False)
class PlannedRun:
    """A run to record.

    Attributes:
        file: that it shall become.
        role: of the run in the data set.
        setpoints: start with steady inputs.
    """

    file: str
    role: Role
    setpoints: SetPoints

    def __repr__(self) -> str:
        return f"PlannedRun({self.file!r}, {self.role}, {self.setpoints.time[-1]:.3g} s)"

    def sample_at(self, rate: float, points: int) -> Run:
        """Sample the run at a rate in Hz as it will be recorded, with so many reference points that are not known yet (NaN)."""
        asked = self.setpoints
        time = np.arange(int(np.floor(asked.time[-1] * rate + 1e-6)) + 1) / rate
        inputs, force = (np.stack([np.interp(time, asked.time, c) for c in part.T], axis=1) for part in (asked.inputs, asked.tip_force))
        return Run(self.file, self.role, time, inputs, force, np.full((len(time), points, 3), np.nan))

    def fingerprint(self, robot: Robot, rate: float) -> str:
        """Changes with anything that changes what would be recorded, but for the rig."""
        parts = (self.setpoints.time, self.setpoints.inputs, self.setpoints.tip_force)
        digest = hashlib.sha256(f"{robot.model_dump_json()} {rate!r} ".encode())
        for part in parts:
            digest.update(part.astype("<f8").tobytes())
        return digest.hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class RecordingPlan:
    """A plan, its inputs worked out and checked.

    Attributes:
        name: of the data set.
        robot: that the inputs are for.
        source: built-in robot or path of a robot file.
        sample_rate: in Hz.
        position_noise: 1 sigma per axis in m, None where unknown.
        runs: in order.
    """

    name: str
    robot: Robot
    source: str
    sample_rate: float
    position_noise: float | None
    runs: tuple[PlannedRun, ...]

    def __repr__(self) -> str:
        return f"RecordingPlan({self.name!r}, robot {self.robot.name!r}, {len(self.runs)} runs at {self.sample_rate:g} Hz)"

    def __post_init__(self) -> None:
        """Refuse files that are named twice.

        Raises:
            InputError: naming the file.
        """
        files = [run.file.lower() for run in self.runs]
        if twice := sorted({name for name in files if files.count(name) > 1}):
            raise InputError(f"plan {self.name!r}: the file {twice[0]!r} is named twice; every run has its own")


def read_plan(path: str | Path) -> RecordingPlan:
    """A plan with all its inputs; paths in it are relative to it.

    Raises:
        InputError: unreadable file, no TOML, unknown key, pattern, input or robot, value out of range, file named twice.
    """
    path = Path(path)
    content = validate(_PlanFile, read_toml(path), str(path))
    source = content.robot if content.robot in builtin_robots() else str(path.parent / content.robot)
    robot = load_robot(source)
    runs = []
    for k, entry in enumerate(content.runs):
        where = f"{path}: runs entry {k + 1}"
        planned = _parse_entry(entry, where)
        setup = PatternContext(robot, content.sample_rate_hz, path.parent, f"{where} ({planned.file})")
        runs.append(PlannedRun(planned.file, planned.role, planned.setpoints(setup)))
    return RecordingPlan(content.name, robot, source, content.sample_rate_hz, content.position_noise_m, tuple(runs))


def _parse_entry(entry: dict[str, Any], where: str) -> RunPlan:
    if ("inputs" in entry) == ("pattern" in entry):
        raise InputError(f"{where}: valid: either pattern = one of {', '.join(PATTERNS)}, or inputs = a set-point file")
    if "inputs" in entry:
        return validate(FileRun, entry, where)
    name = str(entry["pattern"])
    if name not in PATTERNS:
        raise unknown_name("pattern", name, PATTERNS, where)
    return validate(PATTERNS[name], entry, where)
