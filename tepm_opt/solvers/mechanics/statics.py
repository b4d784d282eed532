"""Equilibrium of the network under inputs and known external forces: a stationary point of the potential Π (SPEC section 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg as sla

from tepm_opt.models.backends.interface import LoadCase, Status
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import SOLVED, Ending, Outcome
from tepm_opt.solvers.numerics.text import millimetres

INDIFFERENT = 1e-9  # N/m that count as none
THROUGH_BASE = "a plate runs through the base or the plate below it"


@dataclass(frozen=True)
class StaticsSettings:
    """Settings of the statics solver.

    Attributes:
        tolerance: largest residual force on a node's coordinate, N.
        max_iterations: most Newton steps of one solve.
        min_length_ratio: an actuator shorter than this part of its rest length counts as collapsed.
    """

    tolerance: float = 1e-9
    max_iterations: int = 400
    min_length_ratio: float = 0.25


LIGHTEST, HALVINGS = 1e-3, 12  # part of its mass with which an arm must stand for the mass to be blamed; bisections, to 0.2 %
DEFAULT = StaticsSettings()


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A solved (or explained) equilibrium.

    Attributes:
        model: of which.
        inputs: u, (2 · modules · actuators,) in Pa and N.
        loads: known forces on the reference points in G, (points, 3) in N.
        x: levels 0 … n in the base frame, (n + 1, 3 · actuators) in m.
        points: reference points in G, (points, 3) in m; the last is the tip.
        lengths: actuator lengths L_hj, (modules, actuators) in m.
        outcome: SOLVED, UNSTABLE, COLLAPSED, NOT_CONVERGED or NO_INPUTS; its message explains all but SOLVED.
        iterations, residual: Newton steps; largest residual force in N.
        reached: part of the inputs and loads, scaled together from rest, that has a stable equilibrium on the branch from rest.
        mapped: whether `inputs` are effective actuations (behind the effects' input maps).
    """

    model: CompiledModel
    inputs: np.ndarray
    loads: np.ndarray
    x: np.ndarray
    points: np.ndarray
    lengths: np.ndarray
    outcome: Outcome
    iterations: int
    residual: float
    reached: float = 1.0
    mapped: bool = False

    def __repr__(self) -> str:
        """The outcome and the main numbers, in a line."""
        effort = f"{self.iterations} iterations, residual {self.residual:.2g} N"
        return f"Equilibrium({self.outcome.ending}, tip {millimetres(self.tip)}, {effort})"

    @property
    def solved(self) -> bool:
        """Whether this is a stable equilibrium."""
        return self.outcome.solved

    @cached_property
    def indifferent(self) -> bool:
        """Whether forces balance and nothing holds or drives it, as a mass without a spring: no eigenvalue is clearly negative."""
        return self.outcome.ending is Ending.UNSTABLE and self.smallest_eigenvalue > -INDIFFERENT

    @property
    def tip(self) -> np.ndarray:
        """Tip in G, (3,) in m."""
        return self.points[-1]

    @property
    def nodes(self) -> np.ndarray:
        """All nodes in the base frame, (n + 1, actuators, 3) in m."""
        return self.x.reshape(len(self.x), -1, 3)

    @property
    def load_case(self) -> LoadCase:
        """Inputs, loads and parameters, as backends take them."""
        return LoadCase(self.inputs, self.mapped, self.loads.ravel(), self.model.theta)

    @cached_property
    def properties(self) -> np.ndarray:
        """Properties P of the segments, (n, rows); see `network.PROPERTY_ROWS`."""
        return self.model.reference.prepare(*self.load_case)[1]

    @cached_property
    def smallest_eigenvalue(self) -> float:
        """Smallest eigenvalue of the stiffness matrix in N/m: positive where the equilibrium is stable."""
        band = self.model.reference.assemble(self.x, self.properties, self.model.theta).band
        return float(sla.eig_banded(band, lower=True, eigvals_only=True, select="i", select_range=(0, 0))[0])

    @cached_property
    def edge_forces(self) -> np.ndarray:
        """Axial force of every edge, pulling positive and including the actuators' push, (n, edges) in N; see `Layout.edges`."""
        return self.model.reference.edges(self.x, self.properties, self.model.theta)[0]

    @property
    def tip_tilt(self) -> float:
        """Angle between the normals of the tip plate and the base plate in rad."""
        base, tip = (self._normal(level) for level in (0, -1))
        return float(np.arccos(np.clip(base @ tip, -1.0, 1.0)))

    def _normal(self, level: int) -> np.ndarray:
        ring = self.nodes[level] - self.nodes[level].mean(axis=0)
        turning = np.argsort(np.mod(self.model.layout.angles, 2 * np.pi))
        normal = np.cross(ring[turning], np.roll(ring[turning], -1, axis=0)).sum(axis=0)
        return normal / np.linalg.norm(normal)


def solve_statics(
    model: CompiledModel,
    inputs: Sequence[float] | np.ndarray,
    loads: Sequence[float] | np.ndarray | None = None,
    start: Equilibrium | None = None,
    settings: StaticsSettings = DEFAULT,
) -> Equilibrium:
    """Equilibrium under inputs u and known external forces.

    Newton on the potential with the exact block-tridiagonal stiffness, a positive definite stand-in where it is indefinite, steps
    taken as rotations of the levels, and a line search on the energy (Nocedal and Wright, Numerical Optimization, 2006, ch. 3; the
    rotations are those of co-rotational beams, Crisfield 1990). A solve that fails is followed from rest by load continuation.

    Args:
        model: compiled model.
        inputs: pressures in Pa then tensions in N, (2 · modules · actuators,), within the robot's limits.
        loads: forces in G on the reference points (points, 3) or on the tip (3,), in N.
        start: an equilibrium to start from; rest where absent.
        settings: tolerances.

    Raises:
        InputError: inputs or loads of a wrong shape, not finite or outside the robot's limits.
    """
    case = LoadCase(model.check_inputs(inputs), False, model.check_loads(loads).ravel(), model.theta)
    return _solve(model, case, start, settings, explain=True)


def solve_actuated_statics(
    model: CompiledModel, actuation: np.ndarray, loads: np.ndarray, start: Equilibrium | None = None, explain: bool = False
) -> Equilibrium:
    """Equilibrium under effective actuations, behind the effects' input maps, for checked arrays; else as `solve_statics`.

    Args:
        model: compiled model.
        actuation: pressures, which may be negative, then tensions, (2 · modules · actuators,) in Pa and N.
        loads: known forces on the reference points in G, (points, 3) in N.
        start: an equilibrium to start from; rest where absent.
        explain: whether a failure is followed by continuation; not for trial points of an iteration.
    """
    return _solve(model, LoadCase(actuation, True, loads.ravel(), model.theta), start, DEFAULT, explain)


def _solve(model: CompiledModel, case: LoadCase, start: Equilibrium | None, settings: StaticsSettings, explain: bool) -> Equilibrium:
    found = _newton(model, case, model.rest if start is None else start.x, settings)
    if not found.solved and start is not None:
        found = _newton(model, case, model.rest, settings)
    return found if found.solved or not explain else _follow_branch(found, settings)


def without_inputs(model: CompiledModel, inputs: np.ndarray, loads: np.ndarray) -> Equilibrium:
    """The result for a row that has no inputs: it ended with NO_INPUTS, its points and lengths are NaN."""
    layout = model.layout
    points, lengths = np.full((layout.points, 3), np.nan), np.full((layout.modules, layout.actuators), np.nan)
    outcome = Outcome(Ending.NO_INPUTS, "the row has no inputs")
    return Equilibrium(model, inputs, loads, model.rest, points, lengths, outcome, 0, 0.0, 0.0)


def is_upright(found: Equilibrium) -> bool:
    """Whether an equilibrium is stable and, where gravity pulls towards the base, has not fallen over: half its height is left."""
    robot = found.model.robot
    axis, gravity = robot.mount.rotation[:, 2], np.array(robot.mount.gravity_m_per_s2)
    if not found.solved or axis @ gravity > -0.5 * np.linalg.norm(gravity):
        return found.solved
    height = (found.tip - np.array(robot.mount.base_position_m)) @ axis
    return bool(height > 0.5 * robot.modules * found.model.values["L_0"])


def heaviest(model: CompiledModel) -> float | None:
    """The largest mass m_d of a module in kg with which the arm stands without inputs; None where a lighter one does not stand either.

    Found by bisection between the mass there is, with which it must not stand, and a thousandth of it.
    """
    names = model.network.parameter_names
    masses = [k for k, name in enumerate(names) if name == "m_d"]

    def stands(mass: float) -> bool:
        other = model.with_theta([mass if k in masses else value for k, value in enumerate(model.theta)])
        case = LoadCase(np.zeros(model.layout.inputs), False, other.check_loads(None).ravel(), other.theta)
        return is_upright(_newton(other, case, other.rest, DEFAULT))

    high = model.values["m_d"]
    low = high * LIGHTEST
    if not stands(low):
        return None
    for _ in range(HALVINGS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if stands(middle) else (low, middle)
    return low


def tell_weight(model: CompiledModel) -> str:
    """The largest mass with which an arm that does not stand without inputs would, in words; empty where it is not the mass."""
    most = heaviest(model)
    return "" if most is None else f": m_d = {model.values['m_d']:g} kg is too heavy; valid: up to {most:.2g} kg"


def tell_buckling(model: CompiledModel) -> str:
    """Sentence about an arm that buckles under its own weight, with the largest mass that stands.

    It is empty where the arm stands, or has effects, such as a load.
    """
    if model.model.effects or is_upright(solve_statics(model, np.zeros(model.layout.inputs))):
        return ""
    heavy = tell_weight(model)
    return f"the arm buckles under its own weight{heavy}" if heavy else ""


def _newton(model: CompiledModel, case: LoadCase, x: np.ndarray, settings: StaticsSettings) -> Equilibrium:
    """One Newton solve from x."""
    solution = model.statics.statics(x, case, settings.tolerance, settings.max_iterations)
    layout, split = model.layout, 3 * model.layout.points
    points, lengths = solution.observed[:split].reshape(-1, 3), solution.observed[split:].reshape(layout.modules, layout.actuators)
    outcome = SOLVED
    if solution.status == Status.UNSTABLE:
        outcome = Outcome(solution.status.ending, "the equilibrium is unstable: the stiffness matrix has a negative eigenvalue")
    elif solution.status != Status.SOLVED:
        why = f"not converged after {solution.iterations:.0f} iterations: residual {solution.residual:.3g} N"
        outcome = Outcome(solution.status.ending, why)
    elif layout.run_through(solution.x):
        outcome = Outcome(Ending.COLLAPSED, f"{THROUGH_BASE}: the guide ends there")
    elif lengths.min() < settings.min_length_ratio * model.values["L_0"]:
        why = f"the network collapsed: actuator length {lengths.min():.4f} m is below {settings.min_length_ratio:g} of its rest length"
        outcome = Outcome(Ending.COLLAPSED, why)
    steps, loads = int(solution.iterations), case.external.reshape(-1, 3)
    return Equilibrium(model, case.u, loads, solution.x, points, lengths, outcome, steps, solution.residual, mapped=case.mapped)


def _follow_branch(failed: Equilibrium, settings: StaticsSettings) -> Equilibrium:
    """Follow the branch from rest by scaling inputs and loads from 0 to 1; how far it goes where it does not reach 1."""
    model, case = failed.model, failed.load_case
    last = _newton(model, case._replace(u=0 * case.u, external=0 * case.external), model.rest, settings)
    if last.indifferent or (not last.solved and not model.values["K_a"] > 0):
        why = f"nothing holds the robot: without inputs and loads it has no stiffness (K_a = {model.values['K_a']:g} N/m)"
        return replace(failed, outcome=replace(failed.outcome, message=why), reached=0.0)
    reached, step = 0.0, 0.1
    while last.solved and reached < 1.0 and step > 1e-4:
        part = min(reached + step, 1.0)
        found = _newton(model, case._replace(u=part * case.u, external=part * case.external), last.x, settings)
        if found.solved:
            last, reached, step = found, part, 1.5 * step
        else:
            step /= 4
    if reached == 1.0:
        return last
    where = f"on the branch from rest the last stable equilibrium is at {100 * reached:.1f} % of the inputs and loads"
    if not (reached > 0 or last.solved):
        where = f"without inputs and loads the robot is not stable either{tell_weight(model)}"
    return replace(failed, outcome=replace(failed.outcome, message=f"{failed.outcome.message}; {where}"), reached=reached)
