"""Small motions about an equilibrium: state space with named inputs and outputs, effects with internal states included."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg as sla

from tepm_opt.data.setpoints import AXES
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.models.layout import Layout
from tepm_opt.renamed import RenamedMethod
from tepm_opt.solvers.mechanics.statics import Equilibrium
from tepm_opt.solvers.mechanics.tangent import linearise_network
from tepm_opt.solvers.numerics.matrices import choose_independent_columns
from tepm_opt.solvers.numerics.text import shorten

if TYPE_CHECKING:
    import control

MOMENT = 1e-6  # s: over which the rates of the inputs' internal states are taken
RISING = 1e-12  # 1/s, of an input's range: a rate too slow to matter but for its sign
FORGETS = 1e-6  # 1/s: an internal state that forgets more slowly keeps its value
FORCE_RANGE = 1.0  # N: by which forces are scaled, as pressures and tensions are by the robot's limits
Names = str | Sequence[str] | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Linear:
    """d/dt s = A s + B w(t - delay), z = C s + D w: deviations from an equilibrium in SI (Pa, N → m).

    The states s of a network are the free levels, their velocities, the internal states of the edges (segment by segment) and, with
    actuators, those of the inputs.

    Attributes:
        A, B, C, D: matrices.
        inputs: names of w: "pressure_11" … "tension_23", "force_s1_x" … (forces on the reference points in G).
        outputs: names of z: "s1_x" … (reference points in G), "length_11" … (actuators).
        ranges: of the inputs: the robot's limits, 1 N for forces. What is called scaled is per range.
        delay: by which pressures and tensions (not forces) act late in s; not part of the matrices.
        equilibrium: about which.
        kinds: of the states: "position", "velocity", "edge", "input", or "reduced" without a physical meaning, (states,).
        state_names: "n12_0_x" (level and node), "v_n12_0_x", "edge_1_1" (segment and number), "input_1", (states,).
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    ranges: np.ndarray
    delay: float
    equilibrium: Equilibrium
    kinds: np.ndarray
    state_names: tuple[str, ...]

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        delay = f", delay {1e3 * self.delay:.3g} ms" if self.delay else ""
        size = f"{len(self.A)} states, {len(self.inputs)} inputs, {len(self.outputs)} outputs{delay}"
        return f"Linear({size}, {shorten(self.equilibrium.model.robot.name, 40)})"

    @property
    def late(self) -> np.ndarray:
        """Whether each input acts late, (inputs,) of bool."""
        return np.array([self.delay > 0 and not name.startswith("force_") for name in self.inputs], dtype=bool)

    def select(self, inputs: Names = None, outputs: Names = None) -> Linear:
        """Part of the inputs and outputs, all where absent, by name or by what names begin with ("pressure", "s4").

        Raises:
            InputError: no such input or output.
        """
        system, rows, columns = self.without_held_states(), _find("output", outputs, self.outputs), _find("input", inputs, self.inputs)
        B, C, D = system.B[:, columns], system.C[rows], system.D[np.ix_(rows, columns)]
        names = _pick(self.inputs, columns), _pick(self.outputs, rows)
        return replace(system, B=B, C=C, D=D, inputs=names[0], outputs=names[1], ranges=self.ranges[columns])

    def gain(self, scaled: bool = False) -> np.ndarray:
        """Gain at rest, (outputs, inputs) in m/Pa and m/N, or in m per range."""
        system = self.without_held_states()
        return (system.D - system.C @ np.linalg.solve(system.A, system.B)) * (self.ranges if scaled else 1.0)

    def response(self, frequencies: Sequence[float] | np.ndarray, scaled: bool = False) -> np.ndarray:
        """Frequency response with the exact delay, (frequencies, outputs, inputs); frequencies in Hz, values as for `gain`."""
        system, omega = self.without_held_states(), 2j * np.pi * np.asarray(frequencies, dtype=float)
        triangle, basis = sla.schur(system.A, output="complex")[:2]
        B, C, one = basis.conj().T @ system.B, system.C @ basis, np.eye(len(triangle))
        values = np.array([C @ sla.solve_triangular(s * one - triangle, B, check_finite=False) for s in omega]) + system.D
        values *= np.exp(-self.delay * np.outer(omega, self.late))[:, None]
        return values * (self.ranges if scaled else 1.0)

    def to_control(self, inputs: Names = None, outputs: Names = None, pade: int = 2, scaled: bool = False) -> control.StateSpace:
        """The system for python-control, with named inputs, outputs and states; see `select` and `state_names` for the names.

        Args:
            inputs, outputs: the part wanted.
            pade: order of the Padé approximation of the delay, one for every late input, where there is a delay; 0 leaves it out.
            scaled: inputs per range (a pressure of 1 is the robot's largest) instead of Pa and N. Outputs stay in m.

        Raises:
            InputError: no such input or output, or a wrong order.
        """
        from control import StateSpace  # takes a second to import

        if not (isinstance(pade, int) and 0 <= pade <= 10):
            raise InputError(f"pade: {pade!r}; valid: an order 0 … 10, 0 leaves the delay out")
        part = self.select(inputs, outputs)
        A, B, C, D = part.A, part.B, part.C, part.D
        if pade and part.late.any():
            A, B, C, D = _append_delay(part, pade)
        B, D = (matrix * (part.ranges if scaled else 1.0) for matrix in (B, D))
        states = [*part.state_names, *_delay_names(part, pade)]
        return StateSpace(A, B, C, D, inputs=list(part.inputs), outputs=list(part.outputs), states=states, remove_useless_states=False)

    @property
    def coordinates(self) -> int:
        """Number of coordinates of the free levels: states 0 … are positions, as many more are velocities."""
        return int((self.kinds == "position").sum())

    @property
    def held(self) -> np.ndarray:
        """Internal states that only follow others, (states,) of bool: y = constant + what positions and other internal states make of it.

        Each gives an eigenvalue 0. Dry friction that sticks and hysteresis that holds are of this kind: for small motions they are springs,
        and the constants, which no input reaches, remember how the equilibrium was approached.
        """
        return self._follow[0]

    @cached_property
    def _follow(self) -> tuple[np.ndarray, np.ndarray]:
        """`held`, and how these follow the other states, (held, others)."""
        internal = np.flatnonzero(np.isin(self.kinds, ("edge", "input")))
        by_v, by_y = self.A[np.ix_(internal, self.kinds == "velocity")], self.A[np.ix_(internal, internal)]
        _, rates, weights = np.linalg.svd(by_y.T) if len(by_y) else (by_y, np.zeros(0), by_y)
        kept = weights[rates < FORGETS]  # weights @ y' = weights @ by_v @ v, so weights @ (y - by_v @ x) stays as it is
        kept = kept[~(abs(kept @ self.B[internal]) > FORGETS).any(axis=1)]  # but for those that integrate an input
        which = np.sort(choose_independent_columns(kept, len(kept)))
        kept = np.linalg.solve(kept[:, which], kept)  # now every row says of one state y what it follows
        held = np.zeros(len(self.A), dtype=bool)
        held[internal[which]] = True
        follow = np.zeros((len(kept), len(self.A)))
        follow[:, self.kinds == "position"], follow[:, internal] = kept @ by_v, -kept
        return held, follow[:, ~held]

    def without_held_states(self) -> Linear:
        """Return the system without `held` states, which follow the others from their value at the equilibrium: no eigenvalue 0."""
        held, follow = self._follow
        if not held.any():
            return self
        A, C = (matrix[:, ~held] + matrix[:, held] @ follow for matrix in (self.A[~held], self.C))
        names = _pick(self.state_names, np.flatnonzero(~held))
        return replace(self, A=A, B=self.B[~held], C=C, kinds=self.kinds[~held], state_names=names)

    moving = RenamedMethod("without_held_states")


def linearise(equilibrium: Equilibrium, actuators: bool = True, rising: bool = False) -> Linear:
    """State space about an equilibrium.

    Args:
        equilibrium: solved or unstable; if `mapped`, its inputs stand for commands that act at once.
        actuators: whether the internal states of the inputs (lag, hysteresis) are part of it; else inputs act as at rest.
        rising: for effects that tell rising inputs from falling ones (a regulator that fills faster than it exhausts): which of
            the two. A linear system cannot have both; falling is usually the slower.

    Raises:
        InputError: not an equilibrium.
    """
    model, layout = equilibrium.model, equilibrium.model.layout
    A, by_actuation, by_force = linearise_network(equilibrium)
    F, E, N, M = _inputs(equilibrium, actuators, rising)
    # dy/dt = F y + E du/dt and a = M u + N y become, with q = y - E u: dq/dt = F q + F E u, a = N q + (M + N E) u
    memory, forces = len(F), by_force.shape[1]
    B = np.block([[by_actuation @ (M + N @ E), by_force], [F @ E, np.zeros((memory, forces))]])
    A = np.block([[A, by_actuation @ N], [np.zeros((memory, len(A))), F]])
    observed = model.reference_stepper.jacobian("observe_by", equilibrium.x.ravel(), model.theta)
    size, edges = layout.levels * layout.block, layout.levels * model.reference_stepper.dynamics.edge_states
    C = np.zeros((len(observed), len(A)))
    C[:, :size] = observed[:, layout.block : layout.block + size]
    inputs, outputs = _names(layout)
    delay = 0.0 if equilibrium.mapped else float(model.reference_stepper.value("delay", model.theta)[0].item())
    return Linear(
        A=A, B=B, C=C, D=np.zeros((len(C), B.shape[1])), inputs=inputs, outputs=outputs, delay=delay,
        ranges=np.append(model.input_max, np.full(forces, FORCE_RANGE)), equilibrium=equilibrium,
        kinds=np.repeat(["position", "velocity", "edge", "input"], [size, size, edges, memory]),
        state_names=_state_names(layout, edges // layout.levels, memory),
    )  # fmt: skip


def _inputs(equilibrium: Equilibrium, actuators: bool, rising: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """F, E, N, M of the inputs' internal states y and the effective actuation a: dy/dt = F y + E du/dt, a = M u + N y."""
    model, stepper, count = equilibrium.model, equilibrium.model.reference_stepper, equilibrium.model.layout.inputs
    if equilibrium.mapped:
        return np.zeros((0, 0)), np.zeros((0, count)), np.zeros((count, 0)), np.eye(count)
    memory, rate = stepper.dynamics.input_states, RISING * rising * model.input_max
    by = stepper.jacobian("input_motion_by", equilibrium.inputs, rate, np.zeros(memory), MOMENT, model.theta)
    by_u, by_rate, by_y = np.split(by, [count, 2 * count], axis=1)
    by_y = by_y[:, : memory * actuators]
    reached = slice(count, count + memory * actuators)  # y at the end of the moment
    return (by_y[reached] - np.eye(by_y.shape[1])) / MOMENT, by_rate[reached] / MOMENT, by_y[:count], by_u[:count]


def _append_delay(system: Linear, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Matrices with a Padé approximation of exp(-delay s) before every late input."""
    from control import pade
    from scipy.signal import tf2ss

    a, b, c, d = (np.asarray(part) for part in tf2ss(*pade(1.0, order)))  # a delay of 1 s; then time is scaled
    late = np.eye(len(system.inputs))[:, system.late]
    at_once = np.diag(~system.late).astype(float)
    F, E = np.kron(np.eye(late.shape[1]), a) / system.delay, np.kron(late.T, b) / system.delay
    N, M = np.kron(late, c), at_once + d.item() * (late @ late.T)
    A = np.block([[system.A, system.B @ N], [np.zeros((len(F), len(system.A))), F]])
    return A, np.vstack([system.B @ M, E]), np.hstack([system.C, system.D @ N]), system.D @ M


def _state_names(layout: Layout, edges: int, inputs: int) -> tuple[str, ...]:
    """Names of the states: coordinates, velocities, internal states of a segment's `edges` and of the inputs."""
    nodes = [(level, node) for level in range(1, layout.levels + 1) for node in range(layout.actuators)]
    places = [f"n{level}_{node}_{axis}" for level, node in nodes for axis in AXES]
    of_edges = [f"edge_{segment + 1}_{k + 1}" for segment in range(layout.levels) for k in range(edges)]
    return (*places, *(f"v_{place}" for place in places), *of_edges, *(f"input_{k + 1}" for k in range(inputs)))


def _delay_names(system: Linear, order: int) -> list[str]:
    """Names of the states of `_append_delay`."""
    late = [name for name, is_late in zip(system.inputs, system.late, strict=True) if is_late]
    return [f"delay_{name}_{k + 1}" for name in late for k in range(order)]


def _names(layout: Layout) -> tuple[tuple[str, ...], tuple[str, ...]]:
    actuators, points = layout.actuator_names, [f"{point}_{axis}" for point in layout.point_names for axis in AXES]
    inputs = [f"{kind}_{name}" for kind in ("pressure", "tension") for name in actuators] + [f"force_{point}" for point in points]
    return tuple(inputs), (*points, *(f"length_{name}" for name in actuators))


def _pick(names: Sequence[str], places: Iterable[int]) -> tuple[str, ...]:
    return tuple(names[k] for k in places)


def _find(kind: str, wanted: Names, names: Sequence[str]) -> list[int]:
    """Places of the wanted names; one may stand for all that begin with it and an underscore."""
    if wanted is None:
        return list(range(len(names)))
    found: list[int] = []
    for name in [wanted] if isinstance(wanted, str) else wanted:
        at = [k for k, known in enumerate(names) if known == name or known.startswith(f"{name}_")]
        if not at:
            raise unknown_name(kind, name, names)
        found += at
    if not found or len(set(found)) < len(found):
        raise InputError(f"{kind}s {wanted!r}: {'none' if not found else 'one stands twice'}; valid: each at most once, at least one")
    return found
