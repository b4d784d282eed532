"""A model compiled once into fast functions; what every solver takes."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Literal

import casadi as ca
import numpy as np

from tepm_opt.data.sizes import PRESSURE, TENSION
from tepm_opt.errors import InputError
from tepm_opt.models.backends import ccode
from tepm_opt.models.backends.ccode import Texts
from tepm_opt.models.backends.compiled import CompiledStatics, CompiledTimeStepper, statics_unit, stepping_unit
from tepm_opt.models.backends.interface import StaticsBackend
from tepm_opt.models.backends.kinematics import PythonKinematics
from tepm_opt.models.backends.motion_interface import TimeStepper
from tepm_opt.models.backends.time_stepping import PythonTimeStepper
from tepm_opt.models.backends.written import read_or_write
from tepm_opt.models.dynamics import Dynamics, write_dynamics
from tepm_opt.models.effect import BEGAN, CLOCK, ActiveEffect, Effect
from tepm_opt.models.effects import find_effect
from tepm_opt.models.layout import Layout
from tepm_opt.models.model import Model
from tepm_opt.models.network import Network, write_network
from tepm_opt.models.robot import Robot


@dataclass(frozen=True, eq=False)
class CompiledModel:
    """Functions of a model. Arrays are SI; inputs u are in SPEC's order: pressures in Pa, then tensions in N.

    Attributes:
        model: what was compiled.
        network: its CasADi functions.
        theta: values of its parameters, in the order of `network.parameter_names`.
        statics: equilibria and sensitivities, compiled C or Python.
        reference: the Python backend, which also serves what need not be fast.
    """

    model: Model
    network: Network
    theta: np.ndarray
    statics: StaticsBackend
    reference: PythonKinematics

    def __repr__(self) -> str:
        size = f"{self.layout.levels} levels, {self.layout.inputs} inputs, {len(self.theta)} parameters"
        return f"CompiledModel({self.robot.name} in {'C' if self.is_c else 'Python'}: {size})"

    def __reduce__(self) -> tuple[Callable[..., CompiledModel], tuple[bytes, bool, np.ndarray]]:
        """Reduce for pickle to plain data, which are compiled where they are read, once a process."""
        return _compiled_again, (pickle.dumps(self.model), self.is_c, self.theta)

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.model.robot

    @property
    def layout(self) -> Layout:
        """The network's geometry."""
        return self.network.layout

    @property
    def is_c(self) -> bool:
        """Whether compiled C is in use."""
        return self.statics is not self.reference

    @cached_property
    def _written_dynamics(self) -> tuple[Dynamics, Texts]:
        return read_or_write("time_stepping", self.model, write_dynamics, stepping_unit)

    @cached_property
    def reference_stepper(self) -> PythonTimeStepper:
        """Functions of the moving network, not compiled: what need not be fast."""
        return PythonTimeStepper(self._written_dynamics[0] if self.is_c else write_dynamics(self.model))

    @cached_property
    def stepper(self) -> TimeStepper:
        """Motion in time, compiled when first used: C if the statics are C."""
        library = ccode.build(self._written_dynamics[1]) if self.is_c else None
        return CompiledTimeStepper(self.reference_stepper.dynamics, library) if library else self.reference_stepper

    @cached_property
    def values(self) -> dict[str, float]:
        """Values of the parameters by full name, SI."""
        return dict(zip(self.network.parameter_names, self.theta.tolist(), strict=True))

    def with_theta(self, theta: Sequence[float] | np.ndarray) -> CompiledModel:
        """The same functions with other values of the parameters, which `model` does not know of.

        Raises:
            InputError: wrong number of values, or not finite.
        """
        other = replace(self, theta=finite_array(theta, self.theta.shape, "theta"))
        other.__dict__.update(
            {name: self.__dict__[name] for name in ("_written_dynamics", "reference_stepper", "stepper") if name in self.__dict__}
        )
        return other

    def at_time(self, began: float) -> CompiledModel:
        """This model as it is when a run begins, so many s after the session; itself where no effect asks what time it is."""
        if not self.model.timed:
            return self
        names = self.network.parameter_names
        return self.with_theta([began if name in (CLOCK, BEGAN) else value for name, value in zip(names, self.theta, strict=True)])

    def _find_effects_with(self, hook: str) -> list[tuple[ActiveEffect, Effect, dict[str, ca.SX]]]:
        """The effects with this hook, and their parameters' values as constants."""
        found = [(effect, kind) for effect in self.model.effects if (kind := find_effect(effect.name)).has(hook)]
        return [(effect, kind, self._own(effect, kind)) for effect, kind in found]

    def _own(self, effect: ActiveEffect, kind: Effect) -> dict[str, ca.SX]:
        names = {p.name: f"{effect.label}.{p.name}" for p in kind.parameters_of(self.layout)}
        names |= {CLOCK: CLOCK, BEGAN: BEGAN} if kind.timed else {}
        return {name: ca.SX(self.values[full]) for name, full in names.items()}

    @cached_property
    def without_size(self) -> frozenset[str]:
        """Full names of the parameters that say how effects act that are at their null values: they change nothing."""
        found: list[str] = []
        for effect in self.model.effects:
            own = {f"{effect.label}.{p.name}": p for p in find_effect(effect.name).parameters_of(self.layout)}
            if all(self.values[name] == p.null for name, p in own.items() if not (p.is_shape and p.null)):
                found += [name for name, p in own.items() if p.is_shape]
        return frozenset(found)

    @cached_property
    def is_smooth(self) -> bool:
        """Whether no effect bends or remembers inputs or the edges' motion, which has corners."""
        hooks = "inputs", "pressure_memory", "tension_memory", "edge_memory"
        kinds = [find_effect(effect.name) for effect in self.model.effects]
        return not any(kind.corners or any(kind.has(hook) for hook in hooks) for kind in kinds)

    @cached_property
    def pressure_lag(self) -> tuple[float, float] | None:
        """Time constants in s with which pressures rise and fall, by the effects that declare a lag; None without one.

        Lags that act one after the other are taken as one with the sum of their time constants.
        """
        lags = [lag for _, kind, own in self._find_effects_with("lag") if (lag := kind.lag(own)) is not None]
        return (sum(float(lag.filling) for lag in lags), sum(float(lag.exhausting) for lag in lags)) if lags else None

    @cached_property
    def command_delay(self) -> float | None:
        """Time in s by which commands act late, by the effects that declare a delay; None without one."""
        delays = [float(kind.delay(own)) for _, kind, own in self._find_effects_with("delay")]
        return sum(delays) if delays else None

    def delays(self, time: np.ndarray, forces: bool = False) -> np.ndarray:
        """Times in s by which commands, or known forces, act late at times (times,) in s since the run began, (times,)."""
        if not (self.model.timed and len(time)):
            return np.full(len(time), 0.0 if forces else self.command_delay or 0.0)
        theta = np.tile(self.theta[:, None], len(time))
        clock, began = (self.network.parameter_names.index(name) for name in (CLOCK, BEGAN))
        theta[clock] = theta[began] + time
        return np.array(self.reference_stepper.dynamics.functions["delay"].map(len(time))(theta))[int(forces)]

    @cached_property
    def tendon_friction(self) -> tuple[float, float] | None:
        """Dry friction of the tendons, by the effects that declare it: constant part in N, share of the tension; None without one."""
        found = [friction for _, kind, own in self._find_effects_with("friction") if (friction := kind.friction(own)) is not None]
        return (sum(float(constant) for constant, _ in found), sum(float(share) for _, share in found)) if found else None

    @cached_property
    def pressure_hysteresis(self) -> float:
        """Half the width of the muscles' hysteresis in Pa, by the effects that declare it; 0 without one."""
        found = [half for _, kind, own in self._find_effects_with("hysteresis") if (half := kind.hysteresis(own)) is not None]
        return sum(float(half) for half in found)

    @cached_property
    def theta_without_devices(self) -> np.ndarray:
        """Values of the parameters where every lag, friction of tendons and hysteresis is at its null values, (parameters,)."""
        declared = [each for hook in ("lag", "friction", "hysteresis") for each in self._find_effects_with(hook)]
        null = {f"{effect.label}.{p.name}": p.null for effect, kind, _ in declared for p in kind.parameters_of(self.layout)}
        return np.array([null.get(name, value) for name, value in self.values.items()])

    @cached_property
    def rest(self) -> np.ndarray:
        """Undeformed levels in the base frame, (n + 1, block) in m: where cold solves start."""
        value = self.values
        return self.layout.rest_positions(value["r"], value["L_0"]).reshape(self.layout.levels + 1, -1)

    @cached_property
    def input_max(self) -> np.ndarray:
        """Upper limits of u (the lower ones are 0), (2 · modules · actuators,) in Pa and N."""
        return self.robot.input_max

    @cached_property
    def input_step(self) -> np.ndarray:
        """Resolutions of u, 0 where continuous, (2 · modules · actuators,) in Pa and N."""
        return self.robot.input_step

    def allows(self, inputs: np.ndarray) -> bool:
        """Whether inputs (…, 2 · modules · actuators) are numbers within the robot's limits."""
        return bool(np.isfinite(inputs).all() and not self._exceeds_limits(inputs).any())

    def _exceeds_limits(self, inputs: np.ndarray) -> np.ndarray:
        """Whether each input (…, 2 · modules · actuators) is outside the robot's limits by more than rounding."""
        return np.asarray(np.abs(inputs / self.input_max - 0.5) > 0.5 + 1e-9)

    def check_inputs(self, inputs: Sequence[float] | np.ndarray, where: str = "inputs") -> np.ndarray:
        """Inputs as a float array of shape (2 · modules · actuators,).

        Raises:
            InputError: wrong length, NaN or outside the robot's limits.
        """
        array = finite_array(inputs, self.input_max.shape, where)
        limit = self.input_max
        outside = self._exceeds_limits(array)
        if outside.any():
            at = int(np.argmax(outside))
            kind = PRESSURE if at < self.layout.inputs // 2 else TENSION
            name = self.layout.actuator_names[at % (self.layout.inputs // 2)]
            raise InputError(f"{where}: {kind.name}_{name} = {array[at]:g} {kind.unit}; valid: {kind.valid(array[at], limit[at])}")
        return array

    def check_loads(self, loads: Sequence[float] | np.ndarray | None, where: str = "loads") -> np.ndarray:
        """Known external forces in G on all reference points, (points, 3) in N, from that, a tip force (3,) or None.

        Raises:
            InputError: wrong shape or NaN.
        """
        full = np.zeros((self.layout.points, 3))
        if loads is None:
            return full
        if np.shape(loads) == (3,):
            full[-1] = finite_array(loads, (3,), where)
            return full
        return finite_array(loads, full.shape, where)


def finite_array(values: Sequence[float] | np.ndarray, shape: tuple[int, ...], where: str) -> np.ndarray:
    """Values as a contiguous float array of this shape, all finite.

    Raises:
        InputError: not numbers, wrong shape, NaN or infinite.
    """
    try:
        array = np.ascontiguousarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: not numbers: {error}") from error
    if array.shape != shape:
        raise InputError(f"{where}: shape {array.shape}; valid: {shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{where}: value {int(np.argmin(np.isfinite(array.ravel())))} is not finite; valid: numbers")
    return array


def compile_model(model: Model | Robot | str | Path, backend: Literal["auto", "c", "python"] = "auto") -> CompiledModel:
    """Write a model's network and compile it.

    Args:
        model: a model, or a robot by value, built-in name or path.
        backend: "auto" uses C where a compiler is found; "c" insists on it; "python" runs on CasADi's virtual machine.

    Raises:
        InputError: no such robot, or `backend="c"` where no compiler works.
    """
    model = model if isinstance(model, Model) else Model.from_robot(model)
    network, texts = (write_network(model), None) if backend == "python" else read_or_write("statics", model, write_network, statics_unit)
    reference = PythonKinematics(network)
    library = None if texts is None else ccode.build(texts)
    if backend == "c" and library is None:
        raise InputError("backend 'c': no working C compiler; install one or use backend 'auto'")
    statics = CompiledStatics(network, library) if library else reference
    theta = np.array([model.values.get(name, 0.0) for name in network.parameter_names])
    return CompiledModel(model, network, theta, statics, reference)


def _compiled_again(model: bytes, in_c: bool, theta: np.ndarray) -> CompiledModel:
    """A compiled model that was pickled."""
    return _compiled_once(model, in_c).with_theta(theta)


@lru_cache(maxsize=16)
def _compiled_once(model: bytes, in_c: bool) -> CompiledModel:
    return compile_model(pickle.loads(model), "auto" if in_c else "python")
