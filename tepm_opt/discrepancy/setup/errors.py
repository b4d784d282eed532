"""Set-up errors that were found, and their mends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.setup.hypotheses import SetupHypothesis

KINDS = {
    "swapped_inputs": "Two inputs are exchanged",
    "swapped_actuators": "Actuators are exchanged, pressure and tension",
    "renumbered_module": "A module's actuators are numbered from another start, or the other way round",
    "mirrored_frame": "An axis of the tracker is mirrored",
    "swapped_axes": "Axes of the tracker are exchanged",
    "rotated_frame": "The tracker's frame is turned",
    "scaled_channel": "Inputs are in another unit",
    "absolute_pressure": "Pressures count from vacuum (in positions alone, shorter rest lengths look the same)",
    "inverted_force": "The known force has the wrong sign, or is in another frame",
    "swapped_markers": "Reference points are exchanged",
    "foreign_run": "A run is from another set-up",
    "late_run": "A file's positions are on another clock than its commands",
}
"""Set-up errors by their identifier (SPEC section 5), in a few words."""


@dataclass(frozen=True, eq=False)
class SetupError:
    """A set-up error that was found.

    Attributes:
        kind: identifier (SPEC section 5): "swapped_inputs" ….
        channels: columns concerned.
        mend: the entry of a map, or the line of the data set, that mends it.
        probability: of this error among the set-up hypotheses that do nearly as well.
        left: part of the misfit that is left with the mend.
        hypothesis: the mend.
        is_mended: whether the rest of the verdict is about data with this mend; of alternatives only the first is.
    """

    kind: str
    channels: tuple[str, ...]
    mend: str
    probability: float
    left: float
    hypothesis: SetupHypothesis
    is_mended: bool = False

    def __repr__(self) -> str:
        """The main facts, in a line."""
        return f"SetupError({self.kind}: {', '.join(self.channels)}, probability {self.probability:.2f})"

    @property
    def sentence(self) -> str:
        """The error and its mend, for people."""
        return f"{KINDS[self.kind]} (probability {self.probability:.2f}); mend: {self.mend}"

    def as_json(self) -> dict[str, Any]:
        """Entry of verdict.json."""
        return {"kind": self.kind, "channels": list(self.channels), "mend": self.mend, "probability": round(self.probability, 6)}


def late_run(file: str, seconds: float, left: float) -> SetupError:
    """The error that a file's positions trail its commands by some seconds, or lead them, and leave a part of the misfit without that."""

    def apply(run: Run) -> Run:
        if run.file != file:
            return run
        shifted = [np.interp(run.time + seconds, run.time, column) for column in run.points.reshape(run.rows, -1).T]
        return replace(run, points=np.stack(shifted, axis=1).reshape(run.points.shape))

    mend = f"{file}: take {seconds:.2f} s off the times of its positions"
    return SetupError("late_run", (file,), mend, 1 - left, left, SetupHypothesis("late_run", (file,), mend, apply, "points"))


def foreign_run(file: str, left: float, differs: str = "", probability: float = 1.0) -> SetupError:
    """The error that a run is from another set-up.

    Args:
        file: of the run.
        left: part of the misfit that is left without it.
        differs: value that is another one there, if it is known; the other runs are fitted apart then, and nothing is mended.
        probability: of the error.
    """
    mend = f"leave {file} out, and look what was different there{f': {differs}' if differs else ' (a tendon or hose off, another robot?)'}"
    nothing = SetupHypothesis("foreign_run", (file,), mend, lambda run: run, "points")
    return SetupError("foreign_run", (file,), mend, probability, left, nothing, is_mended=not differs)


def mend_runs(runs: Sequence[Run], setup: Sequence[SetupError]) -> tuple[Run, ...]:
    """The runs with the first of the alternatives of each set-up error mended, without runs from another set-up."""
    for error in setup:
        if error.kind == "foreign_run":
            runs = [run for run in runs if run.file not in error.channels]
        elif error.is_mended or error.kind == "late_run":
            runs = [error.hypothesis.apply(run) for run in runs]
    return tuple(runs)
