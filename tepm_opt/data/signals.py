"""Inputs and outputs of a machine: names, units and sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from tepm_opt.renamed import RenamedMethod

HIGH = 0.8  # of the range


@dataclass(frozen=True)
class Part:
    """Some of the inputs that belong together: an actuator's pressure, all inputs of a module.

    Attributes:
        by: what kind of part it is: "actuator", "module", "input".
        name: of the part: "13 pressure".
        columns: numbers of its inputs.
        alike: numbers of all inputs of its kind; where it is the only one of them in use it is looked at alone, too.
    """

    by: str
    name: str
    columns: tuple[int, ...]
    alike: tuple[int, ...] = ()


@dataclass(frozen=True)
class Regime:
    """Moments at which some of the inputs, or what is measured, are in a part of their range.

    Attributes:
        name: "low pressure".
        when: in a sentence: "at low pressure".
        columns: numbers of the inputs; of what is measured where `measured`. One of them in that part is enough.
        low, high: the part, in parts of the range.
        used: whether only inputs in use count.
        measured: whether it is about what is measured.
    """

    name: str
    when: str
    columns: tuple[int, ...]
    low: float = -inf
    high: float = inf
    used: bool = False
    measured: bool = False


@dataclass(frozen=True)
class Signals:
    """Inputs and outputs of a machine.

    Attributes:
        inputs: columns of the inputs.
        limits: upper limits of the inputs; infinite where unknown.
        points: what is measured, a name each: reference points, or single quantities.
        axes: of each of them: x, y and z, or a single nameless one.
        unit: of what is measured.
        parts: inputs that are looked at together.
        regimes: moments that are looked at.
    """

    inputs: tuple[str, ...]
    limits: tuple[float, ...]
    points: tuple[str, ...]
    axes: tuple[str, ...] = ("",)
    unit: str = ""
    parts: tuple[Part, ...] = ()
    regimes: tuple[Regime, ...] = ()

    @staticmethod
    def from_names(
        inputs: Sequence[str], outputs: Sequence[str], unit: str = "", limits: Sequence[float] = (), axes: Sequence[str] = ("",)
    ) -> Signals:
        """Make signals of single inputs and outputs, each of its own kind.

        Args:
            inputs: names of their columns.
            outputs: names of their columns; of points, whose columns are those of their axes: "p1_x".
            unit: of all outputs; none where they have several.
            limits: upper limits of the inputs; none where unknown.
            axes: of points: "x", "y", "z".
        """
        parts = tuple(Part("input", name, (k,)) for k, name in enumerate(inputs))
        regimes = [Regime(f"high {name}", f"at high {name}", (k,), low=HIGH) for k, name in enumerate(inputs)]
        for k, name in enumerate(outputs):
            regimes.append(Regime(f"high {name}", f"at high {name}", (k,), low=HIGH, measured=True))
            regimes.append(Regime(f"low {name}", f"at low {name}", (k,), high=1 - HIGH, measured=True))
        return Signals(tuple(inputs), tuple(limits) or (inf,) * len(inputs), tuple(outputs), tuple(axes), unit, parts, tuple(regimes))

    of = RenamedMethod("from_names")

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of what is measured, those of a point one after the other."""
        return tuple(f"{point}_{axis}" if axis else point for point in self.points for axis in self.axes)

    @property
    def ranges(self) -> np.ndarray:
        """Upper limits of the inputs, (inputs,)."""
        return np.array(self.limits)
