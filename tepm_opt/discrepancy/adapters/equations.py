"""A machine written down by its equations ẋ = f(x, u, θ), y = h(x, u, θ), with the effects that may be missing in it.

m = Equations("a mass on a spring")
q, v = m.state("q"), m.state("v")
force = m.input("force", size=10.0)
mass, spring = m.parameter("mass", 2.0, "kg"), m.parameter("spring", 500.0, "N/m")
m.rate(q, v)
m.rate(v, (force - spring * q + m.axis("guide", q, v, force=10.0, speed=0.5, position=0.02)) / mass)
m.output("position", q, "m", size=0.02)
plant = m.plant()
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import Any

import casadi as ca

from tepm_opt.data.channels import TIME
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.inputs import Between
from tepm_opt.discrepancy.adapters.motion import DeadTime, Motion
from tepm_opt.discrepancy.laws.axis import AXIS
from tepm_opt.discrepancy.laws.effect import At, Law
from tepm_opt.discrepancy.laws.mechanism import MECHANISM
from tepm_opt.discrepancy.laws.signals import INPUT, OUTPUT
from tepm_opt.discrepancy.laws.vessels import VESSEL
from tepm_opt.discrepancy.problem.parameters import MachineDescription
from tepm_opt.errors import InputError, unknown_name


@dataclass
class Equations(MachineDescription):
    """A machine described by its equations, piece by piece; `plant` makes a plant of them.

    Attributes:
        name: of the machine.
        time: its own time in s: of a swing, of a filling; lags worth a try are parts of it.
        laws: effects that may be missing; where absent those of signals, axes, mechanisms and vessels, without drives and pneumatics.
    """

    time: float = 1.0
    laws: Sequence[Law] = (*INPUT, *AXIS, *MECHANISM, *VESSEL, *OUTPUT)
    _states: dict[str, tuple[ca.SX, float]] = field(default_factory=dict)
    _rates: dict[str, ca.SX] = field(default_factory=dict)
    _inputs: dict[str, tuple[ca.SX, ca.SX, float]] = field(default_factory=dict)
    _outputs: dict[str, tuple[ca.SX, str]] = field(default_factory=dict)
    _symbols: dict[str, ca.SX] = field(default_factory=dict)
    _settled: dict[str, ca.SX] = field(default_factory=dict)  # initial values of the effects' states
    _switches: dict[str, ca.SX] = field(default_factory=dict)
    _late: list[DeadTime] = field(default_factory=list)
    _step: ca.SX = field(default_factory=lambda: ca.SX.sym("h"))

    def state(self, name: str, start: float = 0.0) -> ca.SX:
        """Add a state; `start` is a guess of its value at rest."""
        self._require_new(name, self._states)
        self._states[name] = ca.SX.sym(name), start
        return self._states[name][0]

    def rate(self, state: ca.SX, rate: ca.SX | float) -> None:
        """Set the rate of a state, per s."""
        if state.name() not in self._states:
            raise unknown_name("state", state.name(), self._states)
        self._rates[state.name()] = ca.SX(rate)

    def input(self, name: str, size: float, limit: float = inf, unit: str = "") -> ca.SX:
        """Add an input; returns it after the effects between the command and the machine.

        Args:
            name: of its column.
            size: its usual size.
            limit: its largest value.
            unit: of it.
        """
        self._require_new(name, {TIME: None, **self._inputs, **self._outputs})
        command = ca.SX.sym(name)
        self._inputs[name] = command, command, limit
        acts, sizes = command, self._sizes(name, signal=size, time=self.time)
        for law in sorted(self._laws("input"), key=lambda law: not law.delays):
            acts = self._filter(law, name, acts, sizes, unit)
        self._inputs[name] = command, acts, limit
        return acts

    def axis(self, name: str, q: ca.SX, v: ca.SX, force: float, speed: float, position: float = 1.0, unit: str = "m") -> ca.SX:
        """Add an axis; returns the force of the effects on it, along q.

        Args:
            name: of the axis.
            q, v: its position and speed.
            force, speed, position: their usual sizes there.
            unit: of q; where it is "rad" forces are torques.
        """
        units = {"force": {"m": "N", "rad": "N m"}.get(unit, ""), "speed": f"{unit}/s" if unit else "", "position": unit}
        sizes = self._sizes(name, force=force, speed=speed, position=position, time=self.time)
        return self._sum_effects("axis", name, sizes, units, q, v)

    def mass(self, name: str, size: float) -> ca.SX:
        """Add a mass that may hang at a place; returns it in kg, for the equations to give it weight and inertia.

        Args:
            name: of the place.
            size: a usual mass there in kg.
        """
        total = ca.SX(0)
        for law in self._laws("mass"):
            total += self.effect(law, name, {"mass": size}, {"mass": "kg"})
        return total

    def effect(self, law: Law, name: str, sizes: Mapping[str, float], units: Mapping[str, str] | None = None, **where: Any) -> ca.SX:
        """Add a law of one's own that may act; returns its outcome, 0 where it does not act, for the equations to use.

        Args:
            law: with an outcome that does not depend on delayed commands, see `laws.effect.Law`.
            name: of the part that it acts on; the effect is called "law[name]".
            sizes: usual sizes there by the kinds of size that the law's parameters and function ask for ("force", "position", …).
            units: of these kinds; a kind that is absent has none.
            **where: quantities that the law's function reads: `signal`, `position`, `speed`, `along`, `turned` (see `laws.effect.At`).

        Raises:
            InputError: a size that the law needs is missing or not above 0, or the effect is there already.
        """
        known = self._sizes(name, **{"time": self.time, **sizes})
        asked = {kind for q in law.quantities for kind in q.size.split("/")} - {"1"}
        if lacking := sorted(asked - set(known)):
            raise InputError(f"{self.name}: {law.name}[{name}]: size of {lacking[0]!r} is missing; valid: {', '.join(sorted(asked))}")
        unnamed = dict.fromkeys(set(known) - {"time", "1"}, "")
        acts = self._act(law, name, known, unnamed | dict(units or {}), ca.SX(where.get("signal", 0)), **where)
        return self._switches[f"{law.name}[{name}]"] * acts

    def vessel(self, name: str, level: ca.SX, rate: ca.SX, size: float, unit: str = "", last: bool = False) -> ca.SX:
        """Set the rate of a vessel's level, less the outflow by effects; returns the part of that which enters the next vessel.

        Args:
            name: of the vessel.
            level: a state.
            rate: of the level as far as it is known, per s.
            size: a usual level.
            unit: of the level.
            last: whether there is no next vessel.
        """
        sizes = self._sizes(name, position=size, time=self.time)
        lost = ca.SX(2, 1) + self._sum_effects("last vessel" if last else "vessel", name, sizes, {"position": unit}, level, rate)
        self.rate(level, rate - lost[0])
        return lost[1]

    def output(self, name: str, value: ca.SX, unit: str = "", size: float = 1.0, time: float | None = None) -> None:
        """Add an output, which is measured after the effects between the machine and the record.

        Args:
            name: of its column.
            value: of the machine.
            unit: of it.
            size: its usual size.
            time: the sensor's own in s, where it is not the machine's; it lags by 30 of them at most.
        """
        self._require_new(name, {TIME: None, **self._inputs, **self._outputs})
        sizes = self._sizes(name, signal=size, time=self.time if time is None else time)
        for law in self._laws("output"):
            value = self._filter(law, name, value, sizes, unit)
        self._outputs[name] = ca.SX(value), unit

    def plant(self, substeps: int = 1, between: Between = "line") -> CasadiPlant:
        """The machine with its parameters at these values and all effects at their nulls, see `CasadiPlant`.

        Raises:
            InputError: a state without a rate, no output.
        """
        if lacking := [name for name in self._states if name not in self._rates]:
            raise InputError(f"{self.name}: state {lacking[0]!r} has no rate; valid: m.rate({lacking[0]}, …) for each state")
        if not self._outputs:
            raise InputError(f"{self.name}: nothing is measured; valid: at least one m.output(…)")
        motion = Motion(
            states=tuple(self._states),
            x=ca.vertcat(*(x for x, _ in self._states.values())),
            rates=ca.vertcat(*(self._rates[name] for name in self._states)),
            u=ca.vertcat(*(u for u, _, _ in self._inputs.values()), *(symbol for late in self._late for symbol in late.symbols)),
            y=ca.vertcat(*(y for y, _ in self._outputs.values())),
            theta=ca.vertcat(*self._symbols.values()),
            h=self._step,
            settled=tuple((name, self._settled[name]) for name in self._states if name in self._settled),
            switches=self._switches,
            late=tuple(self._late),
        )
        units = {unit for _, unit in self._outputs.values()}
        unit, limits = units.pop() if len(units) == 1 else "", tuple(limit for *_, limit in self._inputs.values())
        signals = Signals.from_names(tuple(self._inputs), tuple(self._outputs), unit, limits)
        guess = {name: value for name, (_, value) in self._states.items()}
        described = signals, self._free, tuple(self._known), tuple(self._candidates), self._grouped
        return CasadiPlant(self.name, *described, motion, guess, substeps, between)

    def _add_symbol(self, name: str) -> ca.SX:
        self._require_new(name, self._symbols)
        self._symbols[name] = ca.SX.sym(name)
        return self._symbols[name]

    def _laws(self, part: str) -> list[Law]:
        """Effects that act on such a part."""
        return [law for law in self.laws if law.part in {part, f"any {part.split()[-1]}"}]

    def _sum_effects(
        self, part: str, name: str, sizes: Mapping[str, float], units: Mapping[str, str], position: ca.SX, speed: ca.SX
    ) -> ca.SX:
        """Sum of all effects on a part of this kind and name, 0 without any; their states begin at 0."""
        total = ca.SX(0)
        for law in self._laws(part):
            total += self.effect(law, name, sizes, units, position=position, speed=speed)
        return total

    def _filter(self, law: Law, name: str, signal: ca.SX, sizes: Mapping[str, float], unit: str) -> ca.SX:
        """A signal of this name and unit after an effect, whose states begin at the signal."""
        earlier = partial(self._delay, law, name) if law.delays and name in self._inputs else None
        after = self._act(law, name, sizes, {"signal": unit}, signal, signal=signal, earlier=earlier)
        on = self._switches[f"{law.name}[{name}]"]
        return on * after + (1 - on) * signal

    def _act(self, law: Law, name: str, sizes: Mapping[str, float], units: Mapping[str, str], begin: ca.SX, **where: Any) -> ca.SX:
        """Add the parameters, states, candidate and switch of an effect on a part; returns its outcome there, see `laws.effect.At`."""
        label = f"{law.name}[{name}]"
        candidate, free = law.place_on(name, sizes, {"time": "s", "1": "1", **units})
        self._add_free(tuple(free.values()))
        self._candidates.append(candidate)
        p = {own: self._add_symbol(each.name) for own, each in free.items()}
        z = [self.state(f"{label} {k}") for k in range(law.states)]
        acts, rates = law.act(At(p, z, sizes, self._step, **where))
        for state, rate in zip(z, rates, strict=True):
            self.rate(state, rate)
            self._settled[state.name()] = begin
        self._require_new(label, self._switches)
        self._switches[label] = ca.SX.sym(f"{label} acts")
        return acts

    def _delay(self, law: Law, name: str, time: ca.SX) -> ca.SX:
        """The command delayed by a time in s."""
        before = self.state(f"{name} before")
        self.rate(before, 0.0)
        self._settled[before.name()] = self._inputs[name][0]
        self._late.append(DeadTime(f"{law.name}[{name}]", list(self._inputs).index(name), time, before))
        return self._late[-1].signal

    def _sizes(self, of: str, **sizes: float) -> dict[str, float]:
        """Usual sizes of quantities by name, checked."""
        if wrong := [name for name, size in sizes.items() if not 0 < size < inf]:
            raise InputError(f"{self.name}: {of}: {wrong[0]} = {sizes[wrong[0]]:g}; valid: a size above 0")
        return {**sizes, "1": 1.0}
