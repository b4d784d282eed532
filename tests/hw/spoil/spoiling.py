"""What a spoiling is, and which files it may be in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
FIRMWARE, BOARD = "tepm_opt/hw/firmware", "tepm_opt/hw/board"

DRAWS = {
    f"{FIRMWARE}/board.cpp": 18,
    f"{FIRMWARE}/motors.cpp": 10,
    f"{FIRMWARE}/link.cpp": 8,
    f"{FIRMWARE}/adc.cpp": 5,
    f"{FIRMWARE}/config.h": 3,
    f"{FIRMWARE}/frames.cpp": 6,
    f"{FIRMWARE}/memory.cpp": 5,
    f"{FIRMWARE}/uart.cpp": 5,
    f"{FIRMWARE}/dac.cpp": 2,
    f"{FIRMWARE}/spi.h": 1,
    f"{FIRMWARE}/tepm.cpp": 3,
    f"{BOARD}/link.py": 9,
    f"{BOARD}/rig.py": 8,
    f"{BOARD}/limits.py": 5,
    f"{BOARD}/calibration.py": 3,
    f"{BOARD}/protocol.py": 3,
    "tepm_opt/hw/commands.py": 3,
    "tepm_opt/hw/guard.py": 4,
}
"""Files that the robot's safety hangs on, and how many spoilings are drawn from each."""

OTHER = {f"{BOARD}/{name}.py" for name in ("__init__", "errors", "linklog", "ports", "status", "strangers")}
"""Files of the same folders that are left alone: what they do wrong is a line that is silent, a log or words that are wrong."""


class StaleError(Exception):
    """The source no longer has what a spoiling by hand, or an argument for an equivalent one, is written for."""


@dataclass(frozen=True)
class Spoiling:
    """One change of one file.

    Attributes:
        file: path below the project's folder.
        name: what is wrong then; of a drawn one the operator.
        start, end: the characters of the file that are replaced.
        new: by what.
        also: changes of other files that belong to it.
    """

    file: str
    name: str
    start: int
    end: int
    new: str
    also: tuple[Spoiling, ...] = ()

    def spoil(self, text: str) -> str:
        """The file's text with the change."""
        return text[: self.start] + self.new + text[self.end :]

    def lines(self, text: str) -> tuple[str, str]:
        """The lines that change, in one row each, before and after."""
        begin, end = text.rfind("\n", 0, self.start) + 1, text.find("\n", self.end)
        spoilt = text[begin : self.start] + self.new + text[self.end : end]
        return " ".join(text[begin:end].split()), " ".join(spoilt.split())


def source(file: str, root: Path = ROOT) -> str:
    """Text of a file below the project's folder."""
    return (root / file).read_text(encoding="utf-8")


@dataclass(frozen=True)
class Slip:
    """A dangerous slip that a person might make.

    Attributes:
        name: what is wrong then.
        file: path below the project's folder.
        old: what stands there, which is nowhere else in the file.
        new: what stands there then.
        also: the same slip in other files.
    """

    name: str
    file: str
    old: str
    new: str
    also: tuple[Slip, ...] = ()

    def find(self, root: Path = ROOT) -> Spoiling:
        """The spoiling in the project's files.

        Raises:
            StaleError: `old` is not in one, or more than once.
        """
        text = source(self.file, root)
        if (count := text.count(self.old)) != 1:
            raise StaleError(f"spoiling by hand {self.name!r}: {self.file} has {count} times, not once: {self.old!r}")
        start = text.index(self.old)
        return Spoiling(self.file, self.name, start, start + len(self.old), self.new, tuple(slip.find(root) for slip in self.also))
