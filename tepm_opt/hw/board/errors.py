"""Errors between this computer and a board."""

from __future__ import annotations

from tepm_opt.hw.board.strangers import Overheard

FLASH = "flash the firmware that comes with this program"


class LinkError(RuntimeError):
    """The board does not answer, refuses, or the line to it is gone."""


class RefusedError(LinkError):
    """The board refuses a request.

    Attributes:
        result: why.
    """

    def __init__(self, message: str, result: int) -> None:
        super().__init__(message)
        self.result = result


class NoBoardError(LinkError):
    """No board answers.

    Attributes:
        overheard: what came instead.
        says: that in words.
    """

    def __init__(self, overheard: Overheard, seconds: float) -> None:
        self.overheard, self.says = overheard, overheard.describe(seconds)
        super().__init__(f"{self.says}; {overheard.advise(FLASH)}")
