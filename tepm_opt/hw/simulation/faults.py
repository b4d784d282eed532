"""Faults of a simulated rig's tracker and gauges, as a rig file lists them: what is read is not what is there."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from tepm_opt.data.documents import Section, require_range
from tepm_opt.errors import unknown_name
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.devices import generator
from tepm_opt.models.layout import Layout

TRACKER = "tracker"
NEEDS: dict[str, str] = {"repeat": "every", "drop": "probability", "delay": "seconds", "swap": "with"}
"""The key that a kind of fault needs; freeze and invalid need none."""
MOST_FRAMES = 4096
"""Frames that a delay can go back by."""


class Fault(Section):
    """One fault of the tracker (all points), of a reference point or of a gauge, over a span of the rig's time.

    `freeze` repeats the last reading, `repeat` lets every n-th one repeat the one before, `drop` loses readings with a probability, `delay`
    gives older ones with the present time, `swap` exchanges two points or gauges, `invalid` marks poses as not valid (lost).
    """

    kind: Literal["freeze", "repeat", "drop", "delay", "swap", "invalid"]
    of: Annotated[str, Field(min_length=1, description="tracker, a point (s4) or a gauge (pressure_13, tension_21)")] = TRACKER
    from_s: Annotated[float, require_range(0, 1e6, "s")] = 0.0
    until_s: Annotated[float, require_range(0, 1e6, "s")] | None = None
    every: Annotated[int, Field(strict=True, ge=2, le=1000, description="2 … 1000: every n-th reading repeats")] | None = None
    probability: Annotated[float, require_range(0, 1, "a reading")] | None = None
    seconds: Annotated[float, require_range(1e-4, 10, "s")] | None = None
    partner: str | None = Field(default=None, alias="with", min_length=1, description="another point or gauge")

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Fault:
        given = {"every": self.every, "probability": self.probability, "seconds": self.seconds, "with": self.partner}
        need = NEEDS.get(self.kind)
        if need is not None and given[need] is None:
            raise ValueError(f"a fault of kind {self.kind} needs the key {need!r}")
        for key, value in given.items():
            if value is not None and key != need:
                valid = ", ".join(["kind", "of", "from_s", "until_s", *([need] if need else [])])
                raise ValueError(f"a fault of kind {self.kind} has no key {key!r}; valid: {valid}")
        if self.until_s is not None and self.until_s <= self.from_s:
            raise ValueError(f"until_s = {self.until_s:g} is not after from_s = {self.from_s:g}")
        if self.kind == "swap" and self.of in (TRACKER, self.partner):
            raise ValueError("a swap needs two different points, or two different gauges of a kind: of and with")
        return self

    def entries(self) -> dict[str, Any]:
        """Its keys and values as they stand in a file."""
        return self.model_dump(by_alias=True, exclude_none=True)


class FaultInjector:
    """The faults of a rig at work, on one sample after the other.

    Args:
        faults: of the rig file.
        layout: names of points and actuators.
        seed: of the rig.
        noise: number of the run.

    Raises:
        InputError: a fault of something that the robot has not, or a swap of different things.
    """

    def __init__(self, faults: Sequence[Fault], layout: Layout, seed: int, noise: int = 0) -> None:
        self.faults = tuple(faults)
        points, names = layout.point_names, layout.actuator_names
        self._targets = {TRACKER: ("points", np.arange(len(points)))}
        self._targets |= {name: ("points", np.array([k])) for k, name in enumerate(points)}
        for kind, field in (("pressure", "pressures"), ("tension", "tensions")):
            self._targets |= {f"{kind}_{name}": (field, np.array([k])) for k, name in enumerate(names)}
        for number, fault in enumerate(self.faults, 1):
            for name in (fault.of, fault.partner):
                if name is not None and name not in self._targets:
                    raise unknown_name("of" if name == fault.of else "with", name, self._targets, f"faults, entry {number}")
            if fault.partner is not None and self._targets[fault.of][0] != self._targets[fault.partner][0]:
                others = [name for name, (field, _) in self._targets.items() if field == self._targets[fault.of][0]]
                raise unknown_name("with", fault.partner, others, f"faults, entry {number}")
        self.restart(seed, noise)

    def restart(self, seed: int, noise: int) -> None:
        """Start anew with other random numbers."""
        self._random = [generator(seed, f"fault {number}", noise) for number in range(len(self.faults))]
        self._active = [0] * len(self.faults)  # samples since it set in
        self._before: Sample | None = None
        longest = max((fault.seconds or 0.0 for fault in self.faults), default=0.0)
        self._past: deque[Sample] | None = deque(maxlen=MOST_FRAMES) if longest else None

    def apply(self, sample: Sample) -> Sample:
        """A sample as it is read with the faults; the same one where there is none."""
        if not self.faults:
            return sample
        if self._past is not None:
            self._past.append(sample)
        given = sample
        for number, fault in enumerate(self.faults):
            if fault.from_s <= sample.time and (fault.until_s is None or sample.time < fault.until_s):
                self._active[number] += 1
                given = self._add_fault(number, fault, given)
            else:
                self._active[number] = 0
        self._before = given
        return given

    def _add_fault(self, number: int, fault: Fault, sample: Sample) -> Sample:
        """A sample with one fault more."""
        name, which = self._targets[fault.of]
        values: np.ndarray | None = getattr(sample, name)
        if values is None:
            return sample
        before = values if self._before is None else getattr(self._before, name)
        values = values.copy()
        if fault.kind == "freeze" or (fault.kind == "repeat" and fault.every is not None and self._active[number] % fault.every == 0):
            values[which] = before[which]
        elif fault.kind == "invalid":
            values[which] = np.nan
        elif fault.kind == "drop" and fault.probability is not None:
            if self._random[number].random() < fault.probability:
                values[which] = np.nan
        elif fault.kind == "delay" and fault.seconds is not None and self._past is not None:
            old = next((past for past in reversed(self._past) if past.time <= sample.time - fault.seconds + 1e-9), self._past[0])
            values[which] = getattr(old, name)[which]
        elif fault.kind == "swap" and fault.partner is not None:
            other = self._targets[fault.partner][1]
            values[which], values[other] = values[other].copy(), values[which].copy()
        return replace(sample, **{name: values})
