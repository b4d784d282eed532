"""Kalman filter for the arm's slow motion, unknown axial forces, strength, friction and what the tracked points are off by.

The state is [q, q', d, g, c, h, b]: modal coordinates about an operating point (see `solvers.linear.modal_model`), axial forces that nobody
commanded, by what part each muscle is stronger than the model has it, its dry friction, what its force stays behind where its pressure
turns over (hysteresis), and biases of the reference points. Forces that wander and a bias of the tip that does not fade make the tip
nearly free of offset (Pannocchia and Rawlings, Disturbance models for offset-free model-predictive control, AIChE J. 49, 2003).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import scipy.linalg as sla
from scipy.special import chdtri

from tepm_opt.control.estimation.dahl_friction import dahl_step
from tepm_opt.errors import InputError
from tepm_opt.solvers.linear.modal_model import ModalModel


@dataclass(frozen=True)
class FilterSettings:
    """Noise model of the Kalman filter; tuned on twelve random machines (`hw.simulation.family`, seed 900) with the nominal model.

    Attributes:
        force_drift: intensity of the unknown forces' random walk in N/√s.
        force_correlation_time: time in s over which unknown forces fade (Gauss-Markov process).
        force_noise: intensity of white noise on the axial forces in N √s.
        strength_std: standard deviation of the strength before anything was seen, as part of p A.
        strength_drift: intensity of its random walk in 1/√s.
        friction: of a muscle's tendon at the tension's middle before anything was seen, in N.
        friction_std: its standard deviation in N.
        friction_drift: intensity of its random walk in N/√s.
        reversal_noise: standard deviation of the unknown forces in N that one turn-over of the friction adds.
        presliding_distance: distance in m over which friction turns over (Dahl).
        hysteresis: half the hysteresis before anything was seen, in N.
        hysteresis_std: its standard deviation in N.
        hysteresis_drift: intensity of its random walk in N/√s.
        hysteresis_width: change of p A in N over which it turns over.
        load_share: part of the friction that is in proportion to the tension; the friction is meant at the tension's middle.
        rate_time: time constant in s of the smoothed rates that say which way friction pulls.
        bias_std: standard deviation of the points' bias before anything was seen, in m.
        bias_drift: intensity of its random walk in m/√s.
        bias_correlation_time: time in s over which the bias of all points but the tip fades (Gauss-Markov process).
        tip_bias_drift: intensity of the random walk of the tip's bias, which does not fade, in m/√s.
        blind_force_drift: `force_drift` while the tip is lost but other points are tracked.
        blind_force_correlation_time: `force_correlation_time` in s then.
        blind_bias_drift: `bias_drift` then; biases do not fade then, so that the other points say where the tip is.
        gate_probability: probability, by chi-square, of a larger innovation of a good point below which a point is refused as an outlier.
        most_rejections: frames in a row for which a point is refused; after them it is believed. A tip that is missing for longer is lost.
    """

    force_drift: float = 1.2
    force_correlation_time: float = 0.7
    force_noise: float = 0.005
    strength_std: float = 0.05
    strength_drift: float = 0.005
    friction: float = 0.0
    friction_std: float = 2.0
    friction_drift: float = 0.5
    reversal_noise: float = 0.15
    presliding_distance: float = 5e-4
    hysteresis: float = 0.0
    hysteresis_std: float = 0.5
    hysteresis_drift: float = 0.1
    hysteresis_width: float = 1.0
    load_share: float = 0.8
    rate_time: float = 0.08
    bias_std: float = 5e-3
    bias_drift: float = 2e-3
    bias_correlation_time: float = 10.0
    tip_bias_drift: float = 1e-3
    blind_force_drift: float = 0.6
    blind_force_correlation_time: float = 2.0
    blind_bias_drift: float = 2e-4
    gate_probability: float = 1e-6
    most_rejections: int = 10

    def with_friction_prior(self, friction: tuple[float, float] | None, middle: float) -> FilterSettings:
        """Settings that begin with a model's friction; unchanged where it has none.

        Args:
            friction: constant part in N, and share of the tension.
            middle: tension in N.
        """
        if friction is None or not sum(friction):
            return self
        whole = friction[0] + friction[1] * middle
        return replace(self, friction=whole, friction_std=min(self.friction_std, whole / 2))

    def without_tip(self) -> FilterSettings:
        """Settings while the tip is lost: muscles stay as they were learned, biases do not fade."""
        return replace(
            self, force_drift=self.blind_force_drift, force_correlation_time=self.blind_force_correlation_time, strength_drift=0.0,
            friction_drift=0.0, hysteresis_drift=0.0, bias_drift=self.blind_bias_drift, bias_correlation_time=np.inf,
        )  # fmt: skip


DEFAULT = FilterSettings()


@dataclass(frozen=True, eq=False)
class DiscreteModalModel:
    """A modal model in discrete time.

    Attributes:
        model: in continuous time.
        forces: axial forces of its equilibrium, (actuators,) in N.
        A: of [q, q'] over one period, (2 · modes, 2 · modes).
        start, end: what modal forces at the start and the end of a period add, linear between, (2 · modes, modes).
        period: s.
    """

    model: ModalModel
    forces: np.ndarray
    A: np.ndarray
    start: np.ndarray
    end: np.ndarray
    period: float

    @staticmethod
    def from_modal_model(model: ModalModel, forces: np.ndarray, period: float) -> DiscreteModalModel:
        """Discrete model, exact for forces linear in a period (Franklin, Powell, Workman, Digital Control, 1998, section 6.3)."""
        count = len(model.stiffness)
        A = np.zeros((2 * count, 2 * count))
        A[:count, count:] = np.eye(count)
        A[count:, :count], A[count:, count:] = -np.diag(model.stiffness), -model.damping
        moved = sla.expm(A * period)
        forced = np.zeros((2 * count, count))
        forced[count:] = np.eye(count)
        once = np.linalg.solve(A, moved[:, count:] - forced)
        end = np.linalg.solve(A, once - period * forced) / period
        return DiscreteModalModel(model, forces, moved, once - end, end, period)

    def __repr__(self) -> str:
        return f"DiscreteModalModel(modes={len(self.model.stiffness)}, period={self.period:g} s)"

    def double_period(self) -> DiscreteModalModel:
        """Discretise the same model over two periods."""
        start = self.A @ (self.start + self.end / 2) + self.start / 2
        end = self.A @ (self.end / 2) + self.start / 2 + self.end
        return replace(self, A=self.A @ self.A, start=start, end=end, period=2 * self.period)

    def advance(self, state: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """State [q, q'] one period on, (2 · modes,), under axial forces at its start and end, (2, actuators) in N."""
        pushed = (forces - self.forces) @ self.model.drive.T
        return self.A @ state + self.start @ pushed[0] + self.end @ pushed[1]

    def seen_from(self, other: DiscreteModalModel) -> tuple[np.ndarray, np.ndarray]:
        """Turn T and shift t of modal coordinates q that are meant about `other`: about this one they are T q + t."""
        weights = self.model.weights
        return weights @ other.model.shapes, weights @ (other.model.levels - self.model.levels)

    def transform_motion_to(self, motion: np.ndarray, other: DiscreteModalModel) -> np.ndarray:
        """Transform a motion [q, q'] about this operating point, (2 · modes,), to one about another point."""
        if other is self:
            return motion
        turn, shift = other.seen_from(self)
        return np.concatenate([turn @ motion[: len(shift)] + shift, turn @ motion[len(shift) :]])


@dataclass(frozen=True, eq=False)
class StateEstimate:
    """The arm as the filter sees it at a sample's time.

    Attributes:
        operating: about which.
        motion: [q, q'], (2 · modes,).
        unknown: axial forces d that nobody commanded, (actuators,) in N.
        strength: by what part of p A the muscles pull more, g, (actuators,).
        friction: of the muscles c, (actuators,) in N.
        direction: which way it pulls, −1 … 1, (actuators,).
        hysteresis: of the muscles h, (actuators,) in N.
        turning: which way the pressure went, −1 … 1, (actuators,).
        deviation: rates of the actuators' lengths beside the reference's, smoothed, (actuators,) in m/s.
        bias: of the reference points, (points, 3) in m.
        points: where they are, bias included, (points, 3) in m in G.
        nis: normalised innovation squared of the last sample, and `seen`, how many coordinates it had.
        refused: points taken for outliers, (points,) of bool.
    """

    operating: DiscreteModalModel
    motion: np.ndarray
    unknown: np.ndarray
    strength: np.ndarray
    friction: np.ndarray
    direction: np.ndarray
    hysteresis: np.ndarray
    turning: np.ndarray
    deviation: np.ndarray
    bias: np.ndarray
    points: np.ndarray
    nis: float
    seen: int
    refused: np.ndarray

    def __repr__(self) -> str:
        tip = ", ".join(f"{value:.4f}" for value in self.points[-1])
        return f"StateEstimate(tip=({tip}) m, nis={self.nis:.3g}, seen={self.seen}, refused={int(self.refused.sum())})"


@dataclass(frozen=True, eq=False)
class Transition:
    """Step from a sample's state s to the next one's, each about its own operating point: A s + push + kick w, with w of unit covariance.

    Attributes:
        A: (states, states).
        push: what is known, (states,).
        kick: what is not, (states, disturbances).
    """

    A: np.ndarray
    push: np.ndarray
    kick: np.ndarray


@dataclass(frozen=True, eq=False)
class Correction:
    """Correction of the state by a sample's points that were taken.

    Attributes:
        observe: (coordinates, states).
        covariance: of the innovation, (coordinates, coordinates).
        gain: (states, coordinates).
        innovation: (coordinates,) in m.
    """

    observe: np.ndarray
    covariance: np.ndarray
    gain: np.ndarray
    innovation: np.ndarray


class Estimator:
    """The filter; `predict` and `update` in turns.

    Args:
        operating: where the arm rests at the start.
        noise: of a tracked coordinate, 1 sigma in m.
        middle: tension about which the motors work in N.
        settings: what it believes.

    Attributes:
        mean, covariance: of the state.
        correction: by the last sample; None before the first one and where no point of it was taken.
    """

    def __init__(self, operating: DiscreteModalModel, noise: float, middle: float, settings: FilterSettings = DEFAULT) -> None:
        self.operating, self.settings, self.noise, self.middle = operating, settings, noise, middle
        modes, actuators = operating.model.drive.shape
        outputs = len(operating.model.observe)
        ends = np.cumsum([0, 2 * modes, actuators, actuators, actuators, actuators, outputs])
        parts = (slice(*pair) for pair in pairwise(ends))
        self._motion, self._unknown, self._strength, self._friction, self._hysteresis, self._bias = parts
        self._modes, self._tip = modes, slice(ends[-1] - 3, ends[-1])
        self.mean = np.zeros(ends[-1])
        self.mean[self._friction], self.mean[self._hysteresis] = settings.friction, settings.hysteresis
        spread = np.zeros(ends[-1])
        spread[self._motion], spread[self._unknown], spread[self._friction] = 1e-2, 0.5, settings.friction_std
        spread[self._strength], spread[self._hysteresis] = settings.strength_std, settings.hysteresis_std
        spread[self._bias], spread[self._tip] = settings.bias_std, 1e-3
        self.covariance = np.diag(spread**2)
        self._settings_without_tip, self._tip_missing = settings.without_tip(), 0  # frames in a row in which other points were seen
        self._direction, self._deviation, self._turning = np.zeros(actuators), np.zeros(actuators), np.zeros(actuators)
        self._tension: np.ndarray | None = None  # at the last prediction
        self._outlying = np.zeros(outputs // 3, dtype=int)
        self._nis, self._seen = np.nan, 0
        self.correction: Correction | None = None

    def predict(self, forces: np.ndarray, tension: np.ndarray, rates: np.ndarray, then: DiscreteModalModel) -> Transition:
        """Advance the estimate by one period; returns the transition of the state that it used.

        Args:
            forces: known axial forces at its start and end, (2, actuators) in N.
            tension: at the motors, (actuators,) in N.
            rates: of the actuators' lengths as the reference has them, (actuators,) in m/s.
            then: operating point at its end.
        """
        settings, now, before = self.settings, self.operating, self._direction
        seen = now.model.drive.T @ self.mean[self._modes : 2 * self._modes]
        self._deviation = self._deviation + (1 - np.exp(-now.period / settings.rate_time)) * (seen - rates - self._deviation)
        self._direction = dahl_step(before, (rates + self._deviation) * now.period, settings.presliding_distance)
        rise = forces[1] - forces[0] + (0.0 if self._tension is None else tension - self._tension)  # of p A
        self._turning, self._tension = dahl_step(self._turning, rise, settings.hysteresis_width), tension
        done = self._transition(forces, tension, np.abs(self._direction - before), then)
        self.mean = done.A @ self.mean + done.push
        self.covariance = done.A @ self.covariance @ done.A.T + done.kick @ done.kick.T
        self.operating = then
        return done

    def _transition(self, forces: np.ndarray, tension: np.ndarray, turning: np.ndarray, then: DiscreteModalModel) -> Transition:
        """Transition over one period in which frictions turned over by `turning`, (actuators,) of 0 … 2."""
        settings = self._settings_without_tip if self.is_blind else self.settings
        now, size, modes = self.operating, len(self.mean), self._modes
        drive, period = now.model.drive, now.period
        by_force, pushed = (now.start + now.end) @ drive, (forces - now.forces) @ drive.T
        A, push = np.eye(size), np.zeros(size)
        A[self._motion, self._motion] = now.A
        A[self._motion, self._unknown] = by_force
        A[self._motion, self._strength] = by_force * (forces.mean(axis=0) + tension)  # p A
        A[self._motion, self._friction] = -by_force * self._direction * self.friction_ratio_at(tension)
        A[self._motion, self._hysteresis] = -by_force * self._turning
        others = slice(self._bias.start, self._tip.start)
        A[self._unknown, self._unknown] *= np.exp(-period / settings.force_correlation_time)
        A[others, others] *= np.exp(-period / settings.bias_correlation_time)
        push[self._motion] = now.start @ pushed[0] + now.end @ pushed[1]
        variance = period * self._drift(settings) ** 2
        variance[self._unknown] += settings.reversal_noise**2 * turning
        kick = np.zeros((size, len(turning) + size - 2 * modes))
        kick[modes : 2 * modes, : len(turning)] = np.sqrt(period) * settings.force_noise * drive
        kick[2 * modes :, len(turning) :] = np.diag(np.sqrt(variance[2 * modes :]))
        turn, shift = then.seen_from(now)
        for part in (slice(0, modes), slice(modes, 2 * modes)):
            A[part], push[part], kick[part] = turn @ A[part], turn @ push[part], turn @ kick[part]
        push[:modes] += shift
        return Transition(A, push, kick)

    def _drift(self, settings: FilterSettings) -> np.ndarray:
        """Intensities of the states' random walks, (states,)."""
        drift = np.zeros(len(self.mean))
        drift[self._unknown], drift[self._friction] = settings.force_drift, settings.friction_drift
        drift[self._strength], drift[self._hysteresis] = settings.strength_drift, settings.hysteresis_drift
        drift[self._bias], drift[self._tip] = settings.bias_drift, settings.tip_bias_drift
        return drift

    @property
    def is_blind(self) -> bool:
        """Whether the tip is lost: missing for more than `most_rejections` frames in which other points were taken."""
        return self._tip_missing > self.settings.most_rejections

    @property
    def direction(self) -> np.ndarray:
        """Direction of friction now, −1 … 1, (actuators,)."""
        return self._direction

    def friction_ratio_at(self, tension: np.ndarray) -> np.ndarray:
        """Friction at a tension in N over that at the middle one."""
        return 1 - self.settings.load_share + self.settings.load_share * tension / self.middle

    def update(self, points: np.ndarray) -> StateEstimate:
        """Take a sample's points (points, 3) in m in G, NaN where missing.

        Raises:
            InputError: another shape.
        """
        model = self.operating.model
        centre = model.equilibrium.points
        if np.shape(points) != centre.shape:
            raise InputError(f"points: shape {np.shape(points)}; valid: {centre.shape}")
        C = np.zeros((centre.size, len(self.mean)))
        C[:, : self._modes] = model.observe
        C[:, self._bias] = np.eye(centre.size)
        innovation = (points - centre).ravel() - C @ self.mean
        S = C @ self.covariance @ C.T + self.noise**2 * np.eye(len(C))
        there = np.asarray(np.isfinite(points).all(axis=1))
        good: np.ndarray = there & ~self._outliers(innovation, S, there)
        rows = np.repeat(good, 3)
        self._nis, self._seen, self.correction = np.nan, int(rows.sum()), None
        if rows.any():
            self._tip_missing = 0 if good[-1] else self._tip_missing + 1
            C, S, innovation = C[rows], S[np.ix_(rows, rows)], innovation[rows]
            inverse = np.linalg.inv(S)
            gain = (self.covariance @ C.T) @ inverse
            self._nis = float(innovation @ inverse @ innovation)
            self.mean = self.mean + gain @ innovation
            self.correction = Correction(C, S, gain, innovation)
            left = -gain @ C
            left[np.diag_indices(len(left))] += 1
            self.covariance = left @ self.covariance @ left.T + self.noise**2 * (gain @ gain.T)  # Joseph's form
        return self.estimate(there & ~good)

    def _outliers(self, innovation: np.ndarray, S: np.ndarray, there: np.ndarray) -> np.ndarray:
        """Points whose innovation is beyond belief; one that insists is believed."""
        own = S.reshape(len(there), 3, len(there), 3)[np.arange(len(there)), :, np.arange(len(there))]
        apart = innovation.reshape(-1, 3, 1)
        far = (apart * np.linalg.solve(own, apart)).sum(axis=(1, 2))
        wrong = there & (far > _limit(self.settings.gate_probability))
        self._outlying = np.where(wrong, self._outlying + 1, 0)
        return wrong & (self._outlying <= self.settings.most_rejections)

    def estimate(self, refused: np.ndarray) -> StateEstimate:
        """The present estimate; `refused` are the points taken for outliers, (points,) of bool."""
        model, bias = self.operating.model, self.mean[self._bias].reshape(-1, 3)
        points = model.equilibrium.points + (model.observe @ self.mean[: self._modes]).reshape(-1, 3) + bias
        return StateEstimate(
            self.operating, self.mean[self._motion].copy(), self.mean[self._unknown].copy(), self.mean[self._strength].copy(),
            self.mean[self._friction].copy(), self._direction.copy(), self.mean[self._hysteresis].copy(), self._turning.copy(),
            self._deviation.copy(), bias.copy(), points, self._nis, self._seen, refused,
        )  # fmt: skip


@lru_cache(maxsize=8)
def _limit(gate: float) -> float:
    """Largest squared innovation of three coordinates that is believed, by chi-square with the probability `gate`."""
    return float(chdtri(3, gate))
