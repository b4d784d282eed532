"""A machine written down by its equations ẋ = f(x, u, θ), y = h(x, u, θ), with whatever effects may be missing in it.

m = Equations("a mass on a spring")
q, v = m.state("q"), m.state("v")
force = m.input("force", size=10.0)
mass, spring = m.known("mass", 2.0, "kg"), m.known("spring", 500.0, "N/m")
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

import casadi as ca

from tepm_opt.data.channels import TIME
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.casadi_plant import Between, CasadiPlant, Motion
from tepm_opt.discrepancy.adapters.delays import DeadTime
from tepm_opt.discrepancy.laws.axis import AXIS
from tepm_opt.discrepancy.laws.effect import At, Law
from tepm_opt.discrepancy.laws.signals import INPUT, OUTPUT
from tepm_opt.discrepancy.laws.vessels import VESSEL
from tepm_opt.discrepancy.problem.parameters import known_within
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.solvers.plant import Free

FORCES = {"m": "N", "rad": "N m"}
"""What acts along a coordinate of this unit."""


@dataclass
class Equations:
    """What a machine is, noted down piece by piece; `plant` is made of it.

    Attributes:
        name: of the machine.
        time: its own time in s: of a swing, of a filling; lags worth a try are parts of it.
        laws: effects that may be missing; all of the library where not said otherwise.
    """

    name: str
    time: float = 1.0
    laws: Sequence[Law] = (*INPUT, *AXIS, *VESSEL, *OUTPUT)
    _states: dict[str, tuple[ca.SX, float]] = field(default_factory=dict)
    _rates: dict[str, ca.SX] = field(default_factory=dict)
    _inputs: dict[str, tuple[ca.SX, ca.SX, float]] = field(default_factory=dict)
    _outputs: dict[str, tuple[ca.SX, str]] = field(default_factory=dict)
    _free: dict[str, tuple[ca.SX, list[Free]]] = field(default_factory=dict)
    _known: list[str] = field(default_factory=list)
    _grouped: dict[str, tuple[str, ...]] = field(default_factory=dict)
    _settled: dict[str, ca.SX] = field(default_factory=dict)  # what states of effects begin as
    _candidates: list[Candidate] = field(default_factory=list)
    _switches: dict[str, ca.SX] = field(default_factory=dict)
    _late: list[DeadTime] = field(default_factory=list)
    _step: ca.SX = field(default_factory=lambda: ca.SX.sym("h"))

    def state(self, name: str, start: float = 0.0) -> ca.SX:
        """A state; `start` is a guess of its value at rest."""
        self._new(name, self._states)
        self._states[name] = ca.SX.sym(name), start
        return self._states[name][0]

    def rate(self, state: ca.SX, rate: ca.SX | float) -> None:
        """The rate of a state, per s."""
        if state.name() not in self._states:
            raise unknown_name("state", state.name(), self._states)
        self._rates[state.name()] = ca.SX(rate)

    def known(
        self, name: str, value: float, unit: str = "1", within: float = 0.2, low: float | None = None, high: float | None = None,
        std: float = inf, groups: Sequence[str] = (),
    ) -> ca.SX:  # fmt: skip
        """A parameter that is known within a part of its value, or between two values.

        Args:
            name: of the parameter.
            value: the best guess.
            unit: of it.
            within: how far it may be off, in parts of the value.
            low, high: how small and large it may be, instead.
            std: standard deviation of the guess.
            groups: of runs (`group` in dataset.toml), each of which has a value of its own: "name[group]".
        """
        self._new(name, self._free)
        self._free[name] = ca.SX.sym(name), known_within(name, value, unit, within, low, high, std, groups)
        self._known += [free.name for free in self._free[name][1]]
        if groups:
            self._grouped[name] = tuple(groups)
        return self._free[name][0]

    def input(self, name: str, size: float, limit: float = inf, unit: str = "") -> ca.SX:
        """A signal that goes in, after whatever effects stand between the command and what acts.

        Args:
            name: of its column.
            size: as large as it usually is.
            limit: above which it cannot go.
            unit: of it.
        """
        self._new(name, {TIME: None, **self._inputs, **self._outputs})
        command = ca.SX.sym(name)
        self._inputs[name] = command, command, limit
        acts, sizes = command, self._sizes(name, signal=size, time=self.time)
        for law in sorted(self._laws("input"), key=lambda law: not law.delays):
            acts = self._filtered(law, name, acts, sizes, unit)
        self._inputs[name] = command, acts, limit
        return acts

    def axis(self, name: str, q: ca.SX, v: ca.SX, force: float, speed: float, position: float = 1.0, unit: str = "m") -> ca.SX:
        """The force of whatever effects act on an axis, along q.

        Args:
            name: of the axis.
            q, v: its position and speed.
            force, speed, position: as large as they usually are there.
            unit: of q; where it is "rad" forces are torques.
        """
        units = {"force": FORCES.get(unit, ""), "speed": f"{unit}/s" if unit else "", "position": unit}
        sizes = self._sizes(name, force=force, speed=speed, position=position, time=self.time)
        return self._acting("axis", name, sizes, units, q, v, ca.SX(0))

    def vessel(self, name: str, level: ca.SX, rate: ca.SX, size: float, unit: str = "", last: bool = False) -> ca.SX:
        """Note a vessel's level with its rate less what whatever effects let out of it; returns what of that runs into the next vessel.

        Args:
            name: of the vessel.
            level: a state.
            rate: of the level as far as it is known, per s.
            size: a usual level.
            unit: of the level.
            last: whether there is no next vessel.
        """
        sizes = self._sizes(name, position=size, time=self.time)
        lost = self._acting("last vessel" if last else "vessel", name, sizes, {"position": unit}, level, rate, ca.SX(2, 1))
        self.rate(level, rate - lost[0])
        return lost[1]

    def output(self, name: str, value: ca.SX, unit: str = "", size: float = 1.0, time: float | None = None) -> None:
        """What is measured, after whatever effects stand between it and what is written down.

        Args:
            name: of its column.
            value: what the machine has.
            unit: of it.
            size: as large as it usually is.
            time: the sensor's own in s, where it is not the machine's; it lags by 30 of them at most.
        """
        self._new(name, {TIME: None, **self._inputs, **self._outputs})
        sizes = self._sizes(name, signal=size, time=self.time if time is None else time)
        for law in self._laws("output"):
            value = self._filtered(law, name, value, sizes, unit)
        self._outputs[name] = ca.SX(value), unit

    def plant(self, substeps: int = 1, between: Between = "line") -> CasadiPlant:
        """The machine with its parameters at these values and all effects at their nulls, see `CasadiPlant`.

        Raises:
            InputError: a state without a rate, nothing that is measured.
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
            theta=ca.vertcat(*(p for p, _ in self._free.values())),
            h=self._step,
            settled=tuple((name, self._settled[name]) for name in self._states if name in self._settled),
            switches=self._switches,
            late=tuple(self._late),
        )
        units = {unit for _, unit in self._outputs.values()}
        signals = Signals.of(
            tuple(self._inputs),
            tuple(self._outputs),
            units.pop() if len(units) == 1 else "",
            tuple(limit for *_, limit in self._inputs.values()),
        )
        free = {each.name: each for _, group in self._free.values() for each in group}
        start = {name: value for name, (_, value) in self._states.items()}
        known, candidates = tuple(self._known), tuple(self._candidates)
        return CasadiPlant(self.name, signals, free, known, candidates, self._grouped, motion, start, substeps, between)

    def _laws(self, part: str) -> list[Law]:
        """Effects that act on such a part."""
        return [law for law in self.laws if law.part in {part, f"any {part.split()[-1]}"}]

    def _acting(
        self, part: str, name: str, sizes: Mapping[str, float], units: Mapping[str, str], position: ca.SX, speed: ca.SX, total: ca.SX
    ) -> ca.SX:
        """What all effects do to a part of the body; their states begin at 0.

        Args:
            part: what kind of part it is.
            name: of it.
            sizes, units: of quantities there.
            position, speed: of it.
            total: nothing, of the right shape.
        """
        for law in self._laws(part):
            p = self._parameters(law, name, sizes, units)
            z = [self.state(f"{law.name}[{name}] {k}") for k in range(law.states)]
            acts, rates = law.act(At(p, z, sizes, self._step, position=position, speed=speed))
            for state, rate in zip(z, rates, strict=True):
                self.rate(state, rate)
                self._settled[state.name()] = ca.SX(0)
            total += self._switch(law, name) * acts
        return total

    def _sizes(self, of: str, **sizes: float) -> dict[str, float]:
        if wrong := [name for name, size in sizes.items() if not 0 < size < inf]:
            raise InputError(f"{self.name}: {of}: {wrong[0]} = {sizes[wrong[0]]:g}; valid: a size above 0")
        return {**sizes, "1": 1.0}

    def _new(self, name: str, taken: Mapping[str, object]) -> None:
        if name in taken:
            raise InputError(f"{self.name}: {name!r} is there twice; valid: a name of its own for each")

    def _parameters(self, law: Law, part: str, sizes: Mapping[str, float], units: Mapping[str, str]) -> dict[str, ca.SX]:
        """The parameters of an effect on a part of the machine, noted with the candidate that they make.

        Args:
            law: the effect.
            part: of the machine.
            sizes, units: of the quantities there.
        """
        candidate, free = law.on(part, sizes, {"time": "s", "1": "1", **units})
        found = {name: ca.SX.sym(each.name) for name, each in free.items()}
        self._free |= {each.name: (found[name], [each]) for name, each in free.items()}
        self._candidates.append(candidate)
        return found

    def _filtered(self, law: Law, part: str, signal: ca.SX, sizes: Mapping[str, float], unit: str) -> ca.SX:
        """What an effect makes of a signal.

        Args:
            law: the effect.
            part: name of the signal.
            signal: before the effect.
            sizes: of the quantities there.
            unit: of the signal.
        """
        p = self._parameters(law, part, sizes, {"signal": unit})
        z = [self.state(f"{law.name}[{part}] {k}") for k in range(law.states)]
        earlier = partial(self._earlier, law, part) if law.delays and part in self._inputs else None
        after, rates = law.act(At(p, z, sizes, self._step, signal=signal, earlier=earlier))
        for state, rate in zip(z, rates, strict=True):
            self.rate(state, rate)
            self._settled[state.name()] = signal
        on = self._switch(law, part)
        return on * after + (1 - on) * signal

    def _earlier(self, law: Law, part: str, time: ca.SX) -> ca.SX:
        """The command as it was some time ago, in s."""
        label, command = f"{law.name}[{part}]", self._inputs[part][0]
        before = self.state(f"{part} before")
        self.rate(before, 0.0)
        self._settled[before.name()] = command
        self._late.append(DeadTime.with_symbols(label, list(self._inputs).index(part), time, before))
        return self._late[-1].signal

    def _switch(self, law: Law, part: str) -> ca.SX:
        """1 where an effect acts, 0 where it does not."""
        label = f"{law.name}[{part}]"
        self._new(label, self._switches)
        self._switches[label] = ca.SX.sym(f"{label} acts")
        return self._switches[label]
