"""Equations of motion ẋ = f(x, u, θ), y = h(x, u, θ) in CasADi, and the functions that simulate them with sensitivities."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, wraps
from threading import RLock
from typing import ParamSpec, TypeVar, cast

import casadi as ca

Arguments = ParamSpec("Arguments")
Built = TypeVar("Built")
_building = RLock()


def build_alone(make: Callable[Arguments, Built]) -> Callable[Arguments, Built]:
    """Run a function in one thread at a time: CasADi's expressions share state that two threads must not change at once."""

    @wraps(make)
    def alone(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Built:
        with _building:
            return make(*args, **kwargs)

    return alone


def build_once(make: Callable[Arguments, Built]) -> Callable[Arguments, Built]:
    """Run a function in one thread at a time and keep its latest results, of 256 sets of arguments."""
    return cast(Callable[Arguments, Built], build_alone(lru_cache(maxsize=256)(make)))


@dataclass(frozen=True, eq=False)
class DeadTime:
    """A delayed input, given to the equations as further inputs.

    Attributes:
        label: of the effect that delays it.
        number: of the input.
        time: delay in s, in symbols of the parameters.
        before: the input before the run, a state that stays.
    """

    label: str
    number: int
    time: ca.SX
    before: ca.SX

    @cached_property
    def symbols(self) -> tuple[ca.SX, ...]:
        """Value and slope of the delayed input, each as a constant and a factor of `before`, and the delay in s that they hold for."""
        names = "value", "value by before", "slope", "slope by before", "time"
        return tuple(ca.SX.sym(f"{self.label} {name}") for name in names)

    @property
    def signal(self) -> ca.SX:
        """The delayed input; its derivative by the dead time is the slope's negative."""
        value, weight, slope, steep, at = self.symbols
        return value + weight * self.before - (slope + steep * self.before) * (self.time - at)


@dataclass(frozen=True, eq=False)
class Motion:
    """Equations of a machine.

    Attributes:
        states: names of x.
        x, rates: states and their rates.
        u, y: inputs, followed by the symbols of each dead time, and outputs.
        theta: all parameters.
        h: time step in s.
        settled: states that begin at the value of a signal, with that signal; later ones may depend on earlier ones.
        switches: of effects by label: 1 where one acts, 0 where it leaves everything as it is.
        late: dead times of inputs.
    """

    states: tuple[str, ...]
    x: ca.SX
    rates: ca.SX
    u: ca.SX
    y: ca.SX
    theta: ca.SX
    h: ca.SX
    settled: tuple[tuple[str, ca.SX], ...]
    switches: Mapping[str, ca.SX] = field(default_factory=dict)
    late: tuple[DeadTime, ...] = ()

    @build_once
    def restrict_to(self, acting: frozenset[str]) -> Motion:
        """Return the equations with these effects only, without states that no output depends on: a fraction of the work."""
        switches, on = ca.vertcat(*self.switches.values()), ca.DM([label in acting for label in self.switches])
        names, signals = [name for name, _ in self.settled], [signal for _, signal in self.settled]
        rates, y, *signals = ca.substitute([self.rates, self.y, *signals], [switches], [on])
        settled = dict(zip(names, signals, strict=True))
        needed, asked = set(), [name for name in self.states if name not in settled] + self._find_states(y)
        while asked:
            name = asked.pop()
            if name not in needed:
                needed.add(name)
                asked += self._find_states(ca.vertcat(rates[self.states.index(name)], settled.get(name, 0)))
        states = tuple(name for name in self.states if name in needed)
        rows = [self.states.index(name) for name in states]
        left = tuple((name, signal) for name, signal in settled.items() if name in needed)
        x, rates = (ca.vertcat(ca.SX(0, 1), *(column[row] for row in rows)) for column in (self.x, rates))
        late = tuple(each for each in self.late if each.label in acting)
        commands = self.u[: self.u.shape[0] - sum(len(each.symbols) for each in self.late)]
        u = ca.vertcat(commands, *(symbol for each in late for symbol in each.symbols))
        return Motion(states, x, rates, u, y, self.theta, self.h, left, late=late)

    def _find_states(self, value: ca.SX) -> list[str]:
        """Names of the states on which a value depends."""
        return [name for name, there in zip(self.states, ca.which_depends(value, self.x, 1, False), strict=True) if there]

    @cached_property
    def free_states(self) -> tuple[str, ...]:
        """Names of the states that do not begin at the value of a signal."""
        taken = {name for name, _ in self.settled}
        return tuple(name for name in self.states if name not in taken)

    @cached_property
    def with_free_past(self) -> Motion:
        """Equations for a run whose initial state includes the delayed inputs before its first sample."""
        past = {each.before.name() for each in self.late}
        return replace(self, settled=tuple((name, signal) for name, signal in self.settled if name not in past))

    @cached_property
    @build_alone
    def dead_times(self) -> ca.Function:
        """θ → the dead times in s, (dead times,)."""
        return ca.Function("dead_times", [self.theta], [ca.vertcat(ca.SX(0, 1), *(each.time for each in self.late))])

    @cached_property
    @build_alone
    def initial_state(self) -> ca.Function:
        """(x, u, θ, h) → x with every state of `settled` at the value of its signal."""
        x = list(ca.vertsplit(self.x))
        for name, signal in self.settled:
            at = self.states.index(name)
            x[at] = ca.substitute([signal], [self.x], [ca.vertcat(*x)])[0]
        return ca.Function("begin", [self.x, self.u, self.theta, self.h], [ca.vertcat(ca.SX(0, 1), *x)])

    @build_once
    def initial_change(self, directions: int) -> ca.Function:
        """(x, dx, u, θ, dθ, h) → `initial_state` and its change along so many directions."""
        x, u, theta, h = self.x, self.u, self.theta, self.h
        moved, turned = ca.SX.sym("dx", x.shape[0], directions), ca.SX.sym("dtheta", theta.shape[0], directions)
        at = self.initial_state(x, u, theta, h)
        return ca.Function("settling", [x, moved, u, theta, turned, h], [at, _differentiate_along(at, x, theta, moved, turned)])

    @cached_property
    @build_alone
    def initial_rates(self) -> ca.Function:
        """(x, u, θ, h) → rates of the free states with their derivatives by these and by θ, all others at their signals."""
        free = [self.states.index(name) for name in self.free_states]
        rates = ca.substitute([self.rates], [self.x], [self.initial_state(self.x, self.u, self.theta, self.h)])[0][free]
        jacobians = [ca.jacobian(rates, self.x)[:, free], ca.jacobian(rates, self.theta)]
        return ca.Function("rest", [self.x, self.u, self.theta, self.h], [rates, *jacobians])

    @cached_property
    @build_alone
    def output(self) -> ca.Function:
        """(x, u, θ, h) → outputs with their derivatives by x and θ."""
        jacobians = [ca.jacobian(self.y, self.x), ca.jacobian(self.y, self.theta)]
        return ca.Function("measured", [self.x, self.u, self.theta, self.h], [self.y, *jacobians])

    @build_once
    def simulation(self, chosen: tuple[int, ...], substeps: int, samples: int) -> ca.Function:
        """(x, dx, inputs, θ, time steps) → x, dx, outputs and their change at all samples of a run after the first.

        Changes are along directions: each changes one element of θ, `chosen` by its number, or none where that is negative. Runge-Kutta
        of order 4 takes `substeps` equal steps a sample, within which inputs are linear. Inputs are given at the ends of the steps and,
        last, at the sample.
        """
        x, theta, h = self.x, self.theta, self.h
        inputs = self.u.shape[0]
        first, last = ca.SX.sym("u_0", inputs), ca.SX.sym("u_1", inputs)
        field = ca.Function("field", [x, self.u, theta, h], [self.rates])
        middle = (first + last) / 2
        k_1 = field(x, first, theta, h)
        k_2 = field(x + h / 2 * k_1, middle, theta, h)
        k_3 = field(x + h / 2 * k_2, middle, theta, h)
        k_4 = field(x + h * k_3, last, theta, h)
        after = x + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
        moved, turned = ca.SX.sym("dx", x.shape[0], len(chosen)), ca.SX(theta.shape[0], len(chosen))
        for direction, number in enumerate(chosen):
            if number >= 0:
                turned[number, direction] = 1.0
        change_after = _differentiate_along(after, x, theta, moved, turned)
        step = ca.Function("step", [x, moved, first, last, theta, h], [after, change_after])
        seen = ca.Function("seen", [x, moved, self.u, theta, h], [self.y, _differentiate_along(self.y, x, theta, moved, turned)])
        u = ca.SX.sym("u", inputs * (substeps + 2))
        at, change, now = x, moved, u[:inputs]
        for k in range(substeps):
            then = u[(k + 1) * inputs : (k + 2) * inputs]
            at, change = step(at, change, now, then, theta, h)
            now = then
        outputs = seen(at, change, u[-inputs:] if inputs else now, theta, h)
        sample = ca.Function("sampled", [x, moved, u, theta, h], [at, change, *outputs])
        return sample.mapaccum("whole", samples, 2, {"base": 10})


def _differentiate_along(value: ca.SX, x: ca.SX, theta: ca.SX, moved: ca.SX, turned: ca.SX) -> ca.SX:
    """Change of a value along directions of x and θ, (value, directions)."""
    if not moved.shape[1]:
        return ca.SX(value.shape[0], 0)
    return ca.jtimes(value, ca.vertcat(x, theta), ca.vertcat(moved, turned))
