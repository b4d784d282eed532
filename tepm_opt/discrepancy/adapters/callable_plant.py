"""A machine that a function simulates: another simulator, a transfer function, a table; with the effects that may be missing in it.

m = Simulator("a motor", Signals.from_names(["voltage"], ["speed"], "rad/s"))
m.parameter("gain", 2.0, "rad/s/V")
m.effects([Law("dead_zone", "input", (Quantity("width", "signal", 0.0, (0.01, 0.1), 0.0, 1.0),))], "voltage", "V", signal=5.0)

def simulate(run, values):
    voltage, width = run.inputs[:, 0], values["dead_zone[voltage].width"]
    return values["gain"] * (voltage - np.clip(voltage, -width, width))

plant = m.plant(simulate, static=True)
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.laws.effect import At, Law
from tepm_opt.discrepancy.problem.parameters import DescribedPlant, MachineDescription
from tepm_opt.errors import InputError
from tepm_opt.solvers.mechanics.plant import START, Prediction, PredictionError

Simulate = Callable[[Run, Mapping[str, Any]], np.ndarray]


@dataclass(frozen=True, eq=False)
class CallablePlant(DescribedPlant):
    """A machine that a function simulates, see `plant.SearchablePlant`; made by `Simulator`.

    Derivatives are differences: one more simulation for each parameter, a part of its scale away, towards the middle of its range.

    Attributes:
        simulate: (run, values by name) → outputs, (rows, points, axes) or (rows, outputs). It begins with `run.state` where that is not
            None. Where `many`, values are arrays (sets,) and so is the first axis of the outputs.
        states: those that a run may begin with, by name with a guess of each.
        sizes: of the states.
        static: whether rows of runs are equilibria.
        many: whether the function takes many sets of values at once.
        quick: whether a run takes less than some tenths of a second, so that fits may take many steps.
        concurrent: whether the function may run in several threads.
        difference: step of the differences in parts of the parameters' scales: larger where the simulator is noisy.
    """

    simulate: Simulate
    states: Mapping[str, float] = field(default_factory=dict)
    sizes: Mapping[str, float] = field(default_factory=dict)
    static: bool = False
    many: bool = False
    quick: bool = True
    concurrent: bool = False
    difference: float = 1e-3

    derivatives_apart = 0.0
    modules = 1

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"CallablePlant({self.name}, {len(self.known)} known parameters, {len(self.candidates)} effects)"

    def predict(self, run: Run, by: Sequence[str] = (), step: float = np.inf) -> Prediction:
        """Outputs of a run.

        Args:
            run: inputs and times.
            by: parameters by full name, or `START` + a state's name, by which to differentiate.
            step: ignored: the function takes its own.

        Raises:
            PredictionError: the function fails, or gives numbers that are not finite.
            InputError: the run's group is unknown, or the function has a mistake.
        """
        own, values = self.of_run(run), self.values
        steps = {name: self._step(name) for name in by if name.startswith(START) or name in own.values()}
        sets = [values, *({**values, name: values[name] + h} for name, h in steps.items() if not name.startswith(START))]
        found = self._outputs(run, [{short: each[full] for short, full in own.items()} for each in sets])
        moved = iter(found[1:])
        by_name = {}
        for name, h in steps.items():
            at = self._outputs(self._with_state_step(run, name, h), [{short: values[full] for short, full in own.items()}])[0] \
                if name.startswith(START) else next(moved)  # fmt: skip
            by_name[name] = (at - found[0]) / h
        still = np.zeros_like(found[0])
        return Prediction(found[0], np.array([by_name.get(name, still) for name in by]).reshape(len(by), *found[0].shape))

    def _step(self, name: str) -> float:
        """Step of a difference, towards the side where there is more room."""
        if name.startswith(START):
            return self.difference * self.sizes[name.removeprefix(START)]
        free = self.parameters[name]
        h = self.difference * free.scale
        return h if free.high - free.start >= free.start - free.low else -h

    def _with_state_step(self, run: Run, name: str, h: float) -> Run:
        state = np.array(list(self.states.values()) if run.state is None else run.state, dtype=float)
        state[list(self.states).index(name.removeprefix(START))] += h
        return replace(run, state=state)

    def _outputs(self, run: Run, sets: Sequence[Mapping[str, float]]) -> np.ndarray:
        """Outputs with each set of values, (sets, rows, points, axes)."""
        shape = (run.rows, len(self.signals.points), len(self.signals.axes))
        if self.many:
            found = self._call(run, {name: np.array([values[name] for values in sets]) for name in sets[0]})
        else:
            found = np.stack([self._call(run, values) for values in sets])
        whole = (len(sets), *shape)
        if found.shape[:2] != whole[:2] or found.size != np.prod(whole):
            raise InputError(f"{self.name}: the function gives outputs of the shape {found.shape}; valid: {whole if self.many else shape}")
        if not np.isfinite(found).all():
            raise PredictionError(f"{run.file}: {self.name} gives numbers that are not finite")
        return found.reshape(whole)

    def _call(self, run: Run, values: Mapping[str, Any]) -> np.ndarray:
        """Call the function; errors that a simulator may raise on purpose are predictions that fail, others mistakes in it."""
        try:
            with np.errstate(all="ignore"):
                return np.asarray(self.simulate(run, values), dtype=float)
        except InputError:
            raise
        except (ArithmeticError, ValueError, RuntimeError) as error:
            raise PredictionError(f"{run.file}: {self.name}: {error}") from error
        except Exception as error:
            at = traceback.extract_tb(error.__traceback__)[-1]
            raise InputError(f"{at.filename}: line {at.lineno}: {type(error).__name__}: {error}") from error


@dataclass(frozen=True)
class EffectChain:
    """Effects on a part of a machine, one after the other: (values, signal, …) → the signal behind them."""

    laws: tuple[Law, ...]
    part: str
    sizes: Mapping[str, float]

    def __call__(self, values: Mapping[str, Any], signal: Any, **where: Any) -> Any:
        """The signal behind the effects; `where`: further attributes of the place, see `laws.effect.At`."""
        for law in self.laws:
            p = {each.name: values[f"{law.name}[{self.part}].{each.name}"] for each in law.quantities}
            signal, _ = law.act(At(p, [], self.sizes, signal=signal, **where))
        return signal


@dataclass
class Simulator(MachineDescription):
    """A machine that a function simulates, described piece by piece; `plant` makes a plant of it.

    Attributes:
        name: of the machine.
        signals: inputs and outputs.
    """

    signals: Signals
    _states: dict[str, tuple[float, float]] = field(default_factory=dict)

    def state(self, name: str, start: float = 0.0, size: float = 1.0) -> None:
        """Add a state that a run may begin with, `run.state` in this order: a guess of it, and its usual size."""
        self._states[name] = start, size

    def effects(self, laws: Sequence[Law], part: str, unit: str = "", **sizes: float) -> EffectChain:
        """Add effects that may be missing on a part of the machine: "name[part].quantity" are their parameters.

        Args:
            laws: without states of their own, see `laws`.
            part: of the machine.
            unit: of the signal there.
            sizes: of the quantities there, by name: signal=5.0.

        Returns:
            The effects as a function of a signal, for a simulation that does not use their parameters itself.

        Raises:
            InputError: a law with states, a size that is missing.
        """
        for law in laws:
            if law.states:
                raise InputError(f"{self.name}: {law.name} has states, which a function cannot have; valid: Equations, or a law without")
            if law.delays:
                raise InputError(f"{self.name}: {law.name} needs the past, which only the function knows; valid: Equations")
            wanted = {part for q in law.quantities for part in q.size.split("/")} - {"1"}
            if lacking := sorted(wanted - set(sizes)):
                raise InputError(f"{self.name}: {law.name}[{part}] needs the size of {lacking[0]!r}; valid: effects(…, {lacking[0]}=…)")
            units = {**dict.fromkeys(sizes, ""), "signal": unit, "time": "s", "1": "1"}
            candidate, free = law.place_on(part, {**sizes, "1": 1.0}, units)
            self._add_free(tuple(free.values()))
            self._candidates.append(candidate)
        return EffectChain(tuple(laws), part, sizes)

    def plant(self, simulate: Simulate, static: bool = False, many: bool = False, **more: Any) -> CallablePlant:
        """The machine with its parameters at these values and all effects at their nulls.

        Args:
            simulate: see `CallablePlant`.
            static: whether rows of runs are equilibria.
            many: whether the function takes many sets of values at once.
            more: further attributes of `CallablePlant`.
        """
        states, sizes = ({name: each[k] for name, each in self._states.items()} for k in (0, 1))
        described = self.signals, self._free, tuple(self._known), tuple(self._candidates), self._grouped
        return CallablePlant(self.name, *described, simulate, states, sizes, static, many, **more)
