"""The parts of the benchmarks: what `--only` names, and what each needs."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.goals import Goal
from benchmarks.timing import Task

if TYPE_CHECKING:
    from benchmarks.scene import Scene
    from benchmarks.statics import Peers
    from benchmarks.workshop import Workshop


class Part(StrEnum):
    """What can be asked for alone."""

    STILL = "still"
    MOTION = "motion"
    CONTROL = "control"
    RIG = "rig"
    LOOP = "loop"
    VERDICT = "verdict"


MODULES = {
    Part.STILL: ("statics", "gain", "kinematics"),
    Part.MOTION: ("dynamics",),
    Part.CONTROL: ("control",),
    Part.RIG: ("rig",),
    Part.LOOP: ("control_loop",),
    Part.VERDICT: ("verdict",),
}
"""Modules of this package by part, each with `tasks(session)` and `GOALS`."""


@dataclass(frozen=True)
class Session:
    """What the parts share; compiled when the first one asks for it.

    Attributes:
        scratch: folder for what is compiled and written.
        quick: whether to leave out what is slow.
        reference: data set to simulate, or None.
        data: data sets to explain, or None.
    """

    scratch: Path
    quick: bool = False
    reference: Path | None = None
    data: tuple[Path, ...] = ()

    @cached_property
    def scene(self) -> Scene:
        """Robot and operating points."""
        from benchmarks.scene import Scene

        return Scene.of("kang2017")

    @cached_property
    def workshop(self) -> Workshop:
        """The peers' compiler."""
        from benchmarks.workshop import Workshop

        return Workshop.at(self.scratch)

    @cached_property
    def peers(self) -> Peers:
        """Solvers on the peers' network."""
        from benchmarks.statics import Peers

        return Peers.of(self.scene, self.workshop)


def tasks(part: Part, session: Session) -> list[Task]:
    """All tasks of a part.

    Raises:
        InputError: what it needs is not there.
    """
    return [task for name in MODULES[part] for task in import_module(f"benchmarks.{name}").tasks(session)]


def goals(parts: list[Part] | None = None) -> list[Goal]:
    """Targets of some parts, or of all."""
    return [goal for part in parts or Part for name in MODULES[part] for goal in import_module(f"benchmarks.{name}").GOALS]
