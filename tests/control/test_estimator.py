"""The Kalman filter on its own linear model: consistency, dropouts, outliers, offsets; and its discretisation against scipy's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2

from tepm_opt.control.estimation.dahl_friction import dahl_step
from tepm_opt.control.estimation.kalman_filter import DiscreteModalModel, Estimator, FilterSettings, StateEstimate
from tepm_opt.control.references.reference import PERIOD
from tepm_opt.errors import InputError
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import solve_ik
from tepm_opt.solvers.linear.modal_model import modal_model

NOISE = 1e-3 / np.sqrt(3)  # m, of a coordinate
MIDDLE = 3.5  # N
TENSION = np.array([3.5, 2.0, 5.0, 3.0, 4.0, 1.0])  # N
DIRECTION = np.array([1.0, -1, 1, -1, 1, 1])  # in which the muscles move, far enough that friction has turned over in a period
RATES = 1.0 * DIRECTION  # m/s
KNOWN = FilterSettings(rate_time=np.inf)  # it takes RATES for true, not those that it sees, and so knows the DIRECTION
OTHER = FilterSettings(
    force_drift=1.5,
    force_correlation_time=0.6, force_noise=0.01, strength_std=0.1, strength_drift=0.01, friction_std=1.0,
    friction_drift=0.4, reversal_noise=0.3, presliding_distance=2e-4, load_share=0.2, rate_time=np.inf, bias_std=2e-3, bias_drift=1e-3,
    bias_correlation_time=3.0, tip_bias_drift=2e-3, hysteresis_std=0.8, hysteresis_drift=0.3, hysteresis_width=0.4,
)  # fmt: skip
SLOW = np.r_[:4, 10:14, 20:56]  # of the state: fast modes follow their forces, so that their covariance is singular to rounding
PARTS = [20, 26, 32, 38, 44]  # of the state: motion, unknown forces, strength, friction, hysteresis, bias
PROBABILITY = 1e-3  # of a test of consistency that fails though all is well


@pytest.fixture(scope="module")
def circle_points(kang) -> list[DiscreteModalModel]:
    """About some points of the circle, each seen from the one before."""
    found, start = [], None
    for angle in np.radians([0.0, 4.0, 8.0]):
        at = solve_ik(kang, [0.15 * np.cos(angle), 0.15 * np.sin(angle), 0.35], ActuationMode.HYBRID)
        start = modal_model(at.equilibrium, start)
        found.append(DiscreteModalModel.from_modal_model(start, at.forces, PERIOD))
    return found


@pytest.fixture(scope="module")
def here(circle_points) -> DiscreteModalModel:
    """About the circle's first point."""
    return circle_points[0]


class Arm:
    """The linear model that the filter believes in, with the noise that its settings say; without any where `random` is None.

    Attributes:
        motion, unknown, strength, friction, hysteresis, bias: of the truth.
    """

    def __init__(self, at: DiscreteModalModel, settings: FilterSettings, random: np.random.Generator | None = None) -> None:
        self.at, self.settings, self.random = at, settings, random
        self.state = np.zeros(56)
        self.direction, self.turning = np.zeros(6), np.zeros(6)

    def draw(self, deviation: np.ndarray | float) -> np.ndarray:
        """Normally distributed values."""
        return np.zeros(np.shape(deviation)) if self.random is None else deviation * self.random.normal(size=np.shape(deviation))

    def drawn(self, filtered: Estimator) -> Arm:
        """From where the filter believes it at the start."""
        self.state = self.draw(np.sqrt(np.diag(filtered.covariance)))
        return self

    def advance(self, forces: np.ndarray, then: DiscreteModalModel) -> None:
        """One period under axial forces (2, actuators), friction all against DIRECTION."""
        settings, root = self.settings, np.sqrt(PERIOD)
        turning, self.direction = np.abs(DIRECTION - self.direction), DIRECTION
        self.turning = dahl_step(self.turning, forces[1] - forces[0], settings.hysteresis_width)
        load = 1 - settings.load_share + settings.load_share * TENSION / MIDDLE
        pulled = self.hysteresis * self.turning + self.friction * DIRECTION * load
        stronger = self.strength * (forces.mean(axis=0) + TENSION)  # of p A
        motion = self.at.advance(self.motion, forces + self.unknown + stronger - pulled)
        motion[10:] += self.at.model.drive @ self.draw(settings.force_noise * root * np.ones(6))
        kick = np.sqrt(PERIOD * settings.force_drift**2 + settings.reversal_noise**2 * turning)
        self.unknown = np.exp(-PERIOD / settings.force_correlation_time) * self.unknown + self.draw(kick)
        self.strength = self.strength + self.draw(settings.strength_drift * root * np.ones(6))
        self.friction = self.friction + self.draw(settings.friction_drift * root * np.ones(6))
        self.hysteresis = self.hysteresis + self.draw(settings.hysteresis_drift * root * np.ones(6))
        fading = np.exp(-PERIOD / settings.bias_correlation_time)
        drift = np.append(np.full(9, settings.bias_drift), np.full(3, settings.tip_bias_drift))
        self.bias = np.append(fading * self.bias[:9], self.bias[9:]) + self.draw(root * drift)
        turn, shift = then.seen_from(self.at)
        self.motion = np.concatenate([turn @ motion[:10] + shift, turn @ motion[10:]])
        self.at = then

    @property
    def points(self) -> np.ndarray:
        """Where the filter's bias would have them too, (points, 3) in m."""
        model = self.at.model
        return model.equilibrium.points + (model.observe @ self.motion[:10] + self.bias).reshape(-1, 3)

    @property
    def state(self) -> np.ndarray:
        """As the filter's mean."""
        return np.concatenate([self.motion, self.unknown, self.strength, self.friction, self.hysteresis, self.bias])

    @state.setter
    def state(self, values: np.ndarray) -> None:
        self.motion, self.unknown, self.strength, self.friction, self.hysteresis, self.bias = np.split(values, PARTS)

    def seen(self) -> np.ndarray:
        """By the tracker, (points, 3) in m."""
        return self.points + self.draw(np.full((4, 3), NOISE))


def run(arm: Arm, filtered: Estimator, steps: int, where: list[DiscreteModalModel] | None = None) -> Iterator[np.ndarray]:
    """Arm and filter side by side under forces that change: what the tracker sees before the filter does, step by step."""
    where = where or [arm.at]
    turns = np.array([1.0, 0.5, -1.0, 0.3, -0.2, 0.8])
    for k in range(steps):
        forces = arm.at.forces + np.outer(np.sin(0.3 * np.array([k, k + 1])), turns)
        then = where[(k + 1) // 10 % len(where)]
        arm.advance(forces, then)
        filtered.predict(forces, TENSION, RATES, then)
        yield arm.seen()


def bounds(freedom: int) -> tuple[float, float]:
    """Between which a sum of squares with so many degrees of freedom is."""
    return float(chi2.ppf(PROBABILITY / 2, freedom)), float(chi2.isf(PROBABILITY / 2, freedom))


@pytest.mark.sample(3)
@pytest.mark.parametrize(("moving", "settings"), [(True, KNOWN), (False, KNOWN), (True, OTHER)], ids=["moving", "still", "other noise"])
def test_filter_is_consistent(circle_points, moving, settings):
    """NIS over all runs and times, NEES over all runs at some times, against χ²; a fifth of the points is lost, 0.2 s all of them."""
    random = np.random.default_rng(7)
    nis, seen, nees, count = 0.0, 0, {19: 0.0, 60: 0.0, 119: 0.0}, 16
    for _ in range(count):
        filtered = Estimator(circle_points[0], NOISE, MIDDLE, settings)
        arm = Arm(circle_points[0], settings, random).drawn(filtered)
        for k, points in enumerate(run(arm, filtered, 120, circle_points if moving else None)):
            points[random.random(4) < 0.2] = np.nan
            points[:] = np.nan if 50 <= k < 70 else points
            estimate = filtered.update(points)
            nis, seen = nis + np.nan_to_num(estimate.nis), seen + estimate.seen
            assert not estimate.refused.any()
            if k in nees:
                off = (filtered.mean - arm.state)[SLOW]
                nees[k] += off @ np.linalg.solve(filtered.covariance[np.ix_(SLOW, SLOW)], off)
    low, high = bounds(seen)
    assert low < nis < high
    low, high = bounds(len(SLOW) * count)
    assert all(low < value < high for value in nees.values()), (low, nees, high)


@pytest.mark.slow
def test_filter_with_wrong_noise_is_not_consistent(here):
    """The same figures show forces that wander a third faster than the filter believes: the test of consistency can fail."""
    random, settings = np.random.default_rng(8), KNOWN
    nis, seen = 0.0, 0
    for _ in range(24):
        filtered = Estimator(here, NOISE, MIDDLE, settings)
        arm = Arm(here, replace(settings, force_drift=1.33 * settings.force_drift), random).drawn(filtered)
        for points in run(arm, filtered, 120):
            estimate = filtered.update(points)
            nis, seen = nis + estimate.nis, seen + estimate.seen
    assert nis > bounds(seen)[1]


def settled(here: DiscreteModalModel, settings: FilterSettings | None = None, steps: int = 100, seed: int = 3) -> tuple[Arm, Estimator]:
    """An arm and a filter that has watched it for a while."""
    settings = settings or KNOWN
    filtered = Estimator(here, NOISE, MIDDLE, settings)
    arm = Arm(here, KNOWN, np.random.default_rng(seed)).drawn(filtered)
    for points in run(arm, filtered, steps):
        filtered.update(points)
    return arm, filtered


def spread(filtered: Estimator) -> float:
    """Standard deviation of the tip as the filter has it, in m."""
    observe = np.hstack([filtered.operating.model.observe, np.zeros((12, 34)), np.eye(12)])[-3:]
    return float(np.sqrt(np.trace(observe @ filtered.covariance @ observe.T)))


def test_dropout_of_half_a_second(here):
    """The estimate stays finite and gets less certain from period to period; afterwards it is as certain as before, and as near."""
    arm, filtered = settled(here)
    certain, spreads = spread(filtered), []
    for _ in run(arm, filtered, 50):
        estimate = filtered.update(np.full((4, 3), np.nan))
        spreads.append(spread(filtered))
        assert np.isfinite(filtered.mean).all()
        assert np.isnan(estimate.nis)
        assert estimate.seen == 0
        assert not estimate.refused.any()
    assert np.linalg.eigvalsh(filtered.covariance).min() > 0
    assert (np.diff(spreads[:10]) > 0).all()
    assert min(spreads[10:]) > 3 * certain
    for points in run(arm, filtered, 50):
        estimate = filtered.update(points)
    assert spread(filtered) < 1.1 * certain
    assert np.linalg.norm(estimate.points[-1] - arm.points[-1]) < 4 * certain


def test_tip_is_lost_only_while_other_points_are_tracked(here):
    """Blind after more than `most_rejections` frames without the tip; frames without any point do not count, one with the tip ends it."""
    arm, filtered = settled(here)
    for k, points in enumerate(run(arm, filtered, 40)):
        points[-1] = np.nan if k < 30 else points[-1]
        points[:] = np.nan if 5 <= k < 15 else points
        filtered.update(points)
        assert filtered.is_blind == (20 <= k < 30), k


def test_learned_parameters_stay_while_the_tip_is_lost(here):
    """Biases fade and strength becomes less certain while the tip is seen; neither once it is lost."""
    bias, strength = slice(-12, -3), slice(26, 32)
    for lost in (False, True):
        filtered = Estimator(here, NOISE, MIDDLE, KNOWN)
        for points in run(Arm(here, KNOWN), filtered, 12):
            points[-1] = np.nan if lost else points[-1]
            filtered.update(points)
        assert filtered.is_blind == lost
        filtered.mean[bias] = 3e-3
        certain = np.diag(filtered.covariance)[strength]
        for _ in range(100):
            filtered.predict(np.tile(here.forces, (2, 1)), TENSION, RATES, here)
        kept = 1.0 if lost else np.exp(-100 * PERIOD / KNOWN.bias_correlation_time)
        np.testing.assert_allclose(filtered.mean[bias], 3e-3 * kept)
        grown = np.diag(filtered.covariance)[strength] - certain
        np.testing.assert_allclose(grown, 0.0 if lost else 100 * PERIOD * KNOWN.strength_drift**2, atol=1e-12)


@pytest.mark.parametrize("point", [0, 3])
def test_outlier_of_one_frame_is_refused(here, point):
    """30 mm in one point: the estimate is off by less than a twentieth of what it would be without the gate, and forgets it."""
    off = {}
    for gate in (KNOWN.gate_probability, 0.0):
        estimates: list[StateEstimate] = []
        for wrong in (False, True):
            arm, filtered = settled(here, replace(KNOWN, gate_probability=gate))
            points = next(run(arm, filtered, 1))
            points[point] += wrong * np.array([0.0, 0.03, 0.0])
            estimates.append(filtered.update(points))
        clean, outlier = estimates
        assert clean.seen == 12
        assert outlier.refused.tolist() == [gate > 0 and k == point for k in range(4)]
        off[gate] = np.linalg.norm(outlier.points - clean.points, axis=1).max()
    kept, free = off.values()
    assert free > 5e-3
    assert kept < free / 20


@pytest.mark.parametrize("most", [10, 4])
def test_point_that_jumps_for_good_is_believed_after_a_while(here, most):
    """Refused for `most_rejections` frames in a row, taken after that; one good frame in between starts the count anew."""
    arm, filtered = settled(here, replace(KNOWN, most_rejections=most))
    jump, refused = np.array([0.0, 0.0, 0.03]), []
    for k, points in enumerate(run(arm, filtered, 40)):
        points[1] += jump * (k != 5)
        refused.append(filtered.update(points).refused)
    refused = np.array(refused)
    assert not refused[:, [0, 2, 3]].any()
    first = min(most, 5)
    assert refused[:6, 1].tolist() == [True] * first + [False] * (6 - first)
    if most > 5:
        assert refused[6:, 1].tolist() == [True] * most + [False] * (34 - most)
    assert np.linalg.norm(filtered.estimate(refused[-1]).points[1] - arm.points[1] - jump) < 5e-3


@pytest.mark.parametrize("distance", [5e-4, 5e-3])
def test_friction_turns_over_within_the_presliding_distance(here, distance):
    """After a period in which all lengths rise by 1 mm: as Dahl has it; with rates that are smoothed, later the longer they are."""
    forces, rates = np.array([here.forces, here.forces]), np.full(6, 0.1)
    filtered = Estimator(here, NOISE, MIDDLE, replace(KNOWN, presliding_distance=distance))
    filtered.predict(forces, TENSION, rates, here)
    turned = filtered.update(np.full((4, 3), np.nan)).direction
    np.testing.assert_allclose(turned, 1 - np.exp(-1e-3 / distance))


def test_rates_are_smoothed_with_their_time_constant(here):
    """A muscle that moves beside the reference is noticed within `rate_time`."""
    seen = {}
    for time in (0.05, 0.5, np.inf):
        filtered = Estimator(here, NOISE, MIDDLE, replace(KNOWN, rate_time=time))
        filtered.mean[10:20] = 1e-3
        filtered.predict(np.array([here.forces, here.forces]), TENSION, np.zeros(6), here)
        seen[time] = filtered.update(np.full((4, 3), np.nan)).deviation
    moving = here.model.drive.T @ np.full(10, 1e-3)
    for time, found in seen.items():
        np.testing.assert_allclose(found, (1 - np.exp(-PERIOD / time)) * moving, atol=1e-12)


@pytest.mark.parametrize("shape", [(3, 3), (4, 2), (12,)])
def test_wrong_shape_is_refused(here, shape):
    """Other points than the robot's."""
    with pytest.raises(InputError, match="shape"):
        Estimator(here, NOISE, MIDDLE).update(np.zeros(shape))


@pytest.mark.slow
@pytest.mark.parametrize(("memory", "allowed"), [(KNOWN.force_correlation_time, 2.5e-4), (np.inf, 3e-5)])
def test_tip_is_free_of_offset(here, memory, allowed):
    """A force that nobody knows and a bias, both for good: they put the predicted tip 52 mm off, and in the end 0.2 mm; with forces that
    the filter does not let fade 0.02 mm."""
    arm = Arm(here, replace(KNOWN, force_correlation_time=np.inf, bias_correlation_time=np.inf))
    arm.unknown, arm.bias = np.array([1.0, -0.5, 0.0, 0.5, 0.0, -1.0]), np.tile([6e-3, -4e-3, 3e-3], 4)
    arm.motion[:10] = here.model.static(arm.unknown)
    filtered, apart = Estimator(here, NOISE, MIDDLE, replace(KNOWN, force_correlation_time=memory)), []
    for points in run(arm, filtered, 1000):
        predicted = filtered.estimate(np.zeros(4, dtype=bool)).points
        apart.append(np.linalg.norm(predicted[-1] - arm.points[-1]))
        filtered.update(points)
    assert apart[0] > 0.03
    assert max(apart[-100:]) < allowed


@pytest.mark.slow
def test_weak_muscle_is_learned(here):
    """A tenth of what pressure pulls is missing in one muscle: the strength says so once the pressures have changed, and not of others."""
    arm, filtered = Arm(here, KNOWN), Estimator(here, NOISE, MIDDLE, KNOWN)
    arm.strength = np.array([0.0, 0.0, -0.1, 0.0, 0.0, 0.0])
    sway = 8.0 * np.sin(0.03 * np.arange(1201))[:, None] * np.array([1.0, 0.5, -1.0, 0.3, -0.2, 0.8])
    for k in range(1200):
        forces = here.forces + sway[k : k + 2]
        arm.advance(forces, here)
        filtered.predict(forces, TENSION, RATES, here)
        found = filtered.update(arm.points).strength
    assert found[2] < -0.07
    assert np.abs(np.delete(found, 2)).max() < 0.03


@pytest.mark.slow
def test_hysteresis_is_learned(here):
    """One muscle's force stays 0.8 N behind where its pressure turns over: the filter says so of this muscle, and not of others."""
    arm, filtered = Arm(here, KNOWN), Estimator(here, NOISE, MIDDLE, KNOWN)
    arm.hysteresis = np.array([0.0, 0.8, 0.0, 0.0, 0.0, 0.0])
    sway = 8.0 * np.sin(0.03 * np.arange(1201))[:, None] * np.array([1.0, 0.5, -1.0, 0.3, -0.2, 0.8])
    for k in range(1200):
        arm.advance(here.forces + sway[k : k + 2], here)
        filtered.predict(here.forces + sway[k : k + 2], TENSION, RATES, here)
        found = filtered.update(arm.points).hysteresis
    assert found[1] == pytest.approx(0.8, abs=0.3)
    assert np.abs(np.delete(found, 1)).max() < 0.3


def first_order_hold(operating: DiscreteModalModel, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, and what modal forces at the start and the end add: by one exponential of states, forces and their slope."""
    model = operating.model
    count = len(model.stiffness)
    whole = np.zeros((4 * count, 4 * count))
    whole[:count, count : 2 * count] = np.eye(count)
    whole[count : 2 * count, : 2 * count] = np.hstack([-np.diag(model.stiffness), -model.damping])
    whole[count : 2 * count, 2 * count : 3 * count] = np.eye(count)
    whole[2 * count : 3 * count, 3 * count :] = np.eye(count)
    moved = expm(whole * period)[: 2 * count]
    held, slope = moved[:, 2 * count : 3 * count], moved[:, 3 * count :] / period
    return moved[:, : 2 * count], held - slope, slope


def test_discretisation_is_exact_for_forces_linear_in_a_period(here):
    """`of` against the exponential of the augmented system."""
    for found, wanted in zip((here.A, here.start, here.end), first_order_hold(here, PERIOD), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())


def test_doubled_is_two_periods(here):
    """Of forces linear over both, and as discretised anew with twice the period."""
    two = here.double_period()
    assert two.period == 2 * here.period
    for found, wanted in zip((two.A, two.start, two.end), first_order_hold(here, 2 * PERIOD), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())
    random = np.random.default_rng(1)
    state, forces = 0.01 * random.normal(size=20), here.forces + random.normal(size=(2, 6))
    middle = forces.mean(axis=0)
    twice = here.advance(here.advance(state, np.array([forces[0], middle])), np.array([middle, forces[1]]))
    np.testing.assert_allclose(two.advance(state, forces), twice, rtol=1e-9)


def test_advance_holds_what_is_at_rest(here):
    """The modes' static answer to a change of the forces stays where it is."""
    more = np.array([0.5, 0.0, -0.3, 0.2, 0.1, 0.0])
    rest = np.append(here.model.static(more), np.zeros(10))
    np.testing.assert_allclose(here.advance(rest, np.tile(here.forces + more, (2, 1))), rest, atol=1e-12)


def test_coordinates_seen_from_another_point(circle_points):
    """There and back is where it began; the displacement of the network stays the same but for modes that the other has not."""
    first, _, last = circle_points
    coordinates = 0.01 * np.random.default_rng(2).normal(size=10)
    turn, shift = last.seen_from(first)
    there = turn @ coordinates + shift
    back, moved = first.seen_from(last)
    np.testing.assert_allclose(back @ there + moved, coordinates, atol=1e-4)
    levels = first.model.levels + first.model.shapes @ coordinates
    again = last.model.levels + last.model.shapes @ there
    assert np.abs(again - levels).max() < 0.05 * np.abs(levels - last.model.levels).max()
    own, none = first.seen_from(first)
    np.testing.assert_allclose(own, np.eye(10), atol=1e-8)
    assert not none.any()
