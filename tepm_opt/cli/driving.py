"""Options of commands that close the loop: the controller, its settings, and how a path is driven."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import tepm_opt as tepm
from tepm_opt.cli.common import warn
from tepm_opt.cli.groups import OptionGroup

if TYPE_CHECKING:
    from tepm_opt.control.references.time_optimal import PaceSettings
    from tepm_opt.hw.rig import Rig
    from tepm_opt.jobs.closed_loop import LoopSetup
    from tepm_opt.jobs.course import Course
    from tepm_opt.models.compile import CompiledModel

CONTROLLER = "mpc"
CONTROLLERS = f"{CONTROLLER}: the predictive controller; lqg: its plain peer; mode1, mode2: the paper's; a wrong name lists all."


@dataclass(frozen=True)
class DriveOptions(OptionGroup):
    """A controller with its settings, and how it drives a path, for every command that closes the loop."""

    controller: Annotated[str, typer.Option("--controller", help=CONTROLLERS)] = CONTROLLER
    laps: Annotated[float, typer.Option("--laps", help="How often round a closed path.")] = 1.0
    stay: Annotated[
        float | None, typer.Option("--stay", metavar="S", help="Point by point, S seconds each, of which the last third counts.")
    ] = None
    keep_out: Annotated[
        Path | None, typer.Option("--keep-out", metavar="FILE", help="Obstacles to keep out of: spheres, boxes, a table (TOML).")
    ] = None
    free: Annotated[
        bool, typer.Option("--free-progress", help="MPC: as fast along the path as the actuators can follow, whatever its time.")
    ] = False
    sway: Annotated[
        float | None,
        typer.Option("--sway", min=0.1, max=200.0, metavar="MM", help="How far inertia may bend the arm then.", show_default="10"),
    ] = None
    use: Annotated[str | None, typer.Option("--use", help="MPC: both, tension or pressure.", show_default="both")] = None

    def check(self, learning: bool = False) -> None:
        """Refuse options that do not go together; `learning` says whether rounds of learning are asked for.

        Raises:
            InputError: the first pair that does not.
        """
        refused = {
            "--learn and --learned correct a path; leave --stay out": self.stay is not None and learning,
            "--keep-out does not go with --learn and --learned, whose corrections know no obstacles; leave one out": (
                self.keep_out is not None and learning
            ),
            f"--free-progress is for a path and --controller {CONTROLLER}; leave --learn, --learned and --stay out": (
                self.free and (self.controller != CONTROLLER or learning or self.stay is not None)
            ),
            "--sway belongs to --free-progress; leave it out, or free the progress": self.sway is not None and not self.free,
        }
        for text, wrong in refused.items():
            if wrong:
                raise tepm.InputError(text)

    def setup(self, rig: str, seed: int) -> LoopSetup:
        """Controller and rig of a closed loop.

        Raises:
            InputError: no such controller, or a setting that it does not have.
        """
        return tepm.LoopSetup.from_options(self.controller, rig, seed, {"use": self.use} if self.use else {})

    def course(self, setup: LoopSetup) -> Course:
        """Laps, stays, obstacles and pace of the run.

        Raises:
            InputError: a file of obstacles that cannot be read.
        """
        from tepm_opt.jobs.course import FULL

        driven = replace(FULL, laps=self.laps, stay=self.stay, steps=setup.kind.jumps)
        keep_out = None if self.keep_out is None else tepm.read_obstacles(self.keep_out)
        return replace(driven, keep_out=keep_out, pace=self._pace())

    def check_rest(self, model: CompiledModel, course: Course, rig: Rig) -> None:
        """Tell a person where the arm at rest is inside an obstacle.

        Raises:
            InputError: it is, and the rig is a real one, which begins there.
        """
        from tepm_opt.control.collision.model import CollisionModel

        if course.keep_out is None or not (inside := CollisionModel(model, course.keep_out).at_rest()):
            return
        if rig.simulated is None:
            raise tepm.InputError(f"{self.keep_out}: {inside}")
        warn(f"{self.keep_out}: {inside}")

    def _pace(self) -> PaceSettings | None:
        """Settings of free progress; None where the path's time holds."""
        from tepm_opt.control.references.time_optimal import PaceSettings

        if not self.free:
            return None
        return PaceSettings() if self.sway is None else PaceSettings(sway=self.sway / 1e3)
