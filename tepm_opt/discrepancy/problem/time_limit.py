"""Time that a search may take, and what it left untried."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.solvers.mechanics.plant import PredictionError
from tepm_opt.solvers.numerics.text import format_names


class TimeLimitError(PredictionError):
    """Ends a fit at the time limit of its search; to the search it is a fit that failed."""


@dataclass(eq=False)
class TimeLimit:
    """The time limit of a search, and the sets of effects that were not fitted for want of time.

    Attributes:
        minutes: from when it was made; infinite for none.
        untried: sets of effects, in the order in which the search asked for them.
        skipped: other pieces of work that were left out, in words.
    """

    minutes: float = float("inf")
    untried: dict[tuple[Candidate, ...], None] = field(default_factory=dict)
    skipped: dict[str, None] = field(default_factory=dict)
    _began: float = field(default_factory=time.monotonic)

    @property
    def is_over(self) -> bool:
        """Whether the time is up."""
        return time.monotonic() - self._began > 60 * self.minutes

    def check(self, effects: tuple[Candidate, ...]) -> None:
        """Refuse the fit of a set of effects when the time is up, and note it.

        Raises:
            TimeLimitError: the time is up.
        """
        if self.is_over:
            self.untried[effects] = None
            raise TimeLimitError(f"the {self.minutes:g} minutes are over")

    def allows(self, work: str) -> bool:
        """Whether there is time for another piece of work, which is noted in words if not."""
        if self.is_over:
            self.skipped[work] = None
        return not self.is_over

    @property
    def was_short(self) -> bool:
        """Whether anything was left out."""
        return bool(self.untried or self.skipped)

    def rivals(self, effect: Candidate) -> int:
        """Number of untried sets that do without an effect."""
        return sum(effect not in effects for effects in self.untried)

    @property
    def remark(self) -> str:
        """Sentences about what was left out."""
        names = format_names(list(dict.fromkeys(effect.full_label for effects in self.untried for effect in effects)), 5)
        sets = "one set" if len(self.untried) == 1 else f"{len(self.untried)} sets"
        left = [f"{sets} of effects unfitted, with {names}"] if self.untried else []
        left += [f"undone: {format_names(list(self.skipped), 3)}"] if self.skipped else []
        return (
            f"Time: the search ended after {self.minutes:g} minutes and left {'; '.join(left)}. "
            "Nothing of that is ruled out; the same command with more minutes goes on from there."
        )
