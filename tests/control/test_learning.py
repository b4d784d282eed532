"""Learning over rounds, on a plant that is a delay and a disturbance that repeats."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.control.references.iterative_learning import Learner, LearningSettings
from tepm_opt.errors import InputError

PERIOD, COUNT = 0.01, 1000
ROWS, COUNTED = np.arange(COUNT), np.ones(COUNT, dtype=bool)
TIME = PERIOD * ROWS
PATH = np.stack([0.15 * np.cos(TIME), 0.15 * np.sin(TIME), np.full(COUNT, 0.35)], axis=1)
FADE = np.clip(TIME / 2 - 1, 0, 1)[:, None]  # nothing is learned near the start from rest
REPEATING = 4e-3 * FADE * np.sin(2 * np.pi * 0.5 * TIME)[:, None] * [1.0, -0.5, 0.3]


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def rounds(learner: Learner, count: int, noise: float = 0.0, quick: float = 0.0, delay: int = 2) -> list[float]:
    """Errors in truth of a loop that follows its targets late and is disturbed the same way in every round."""
    random, found = np.random.default_rng(3), []
    for _ in range(count):
        target = PATH + learner.correction
        tips = np.vstack([np.repeat(target[:1], delay, axis=0), target[: COUNT - delay]]) if delay else target
        tips = tips - np.roll(PATH, delay, axis=0) + PATH + REPEATING  # what it knows of the path it is not late for
        tips[:delay] = PATH[:delay]
        found.append(rms(tips - PATH))
        tips = tips + quick * np.sin(2 * np.pi * 12 * TIME + random.uniform(0, 6))[:, None] + noise * random.normal(size=tips.shape)
        learner.learn(ROWS, tips, COUNTED)
    return found


def test_what_repeats_is_learned_in_a_few_rounds() -> None:
    errors = rounds(Learner(PATH, PERIOD), 6)
    assert errors[1] < 0.3 * errors[0]
    assert errors[5] < 0.03 * errors[0]


def test_noise_is_not_learned() -> None:
    """Noise of 1 mm (3-D) and a sway of 12 Hz: less than 0.2 mm of them comes in."""
    learner = Learner(PATH, PERIOD)
    errors = rounds(learner, 6, noise=1e-3 / np.sqrt(3), quick=2e-3)
    assert errors[5] < 0.3e-3
    still = Learner(PATH, PERIOD)
    random = np.random.default_rng(5)
    for _ in range(6):
        still.learn(ROWS, PATH + 1e-3 / np.sqrt(3) * random.normal(size=PATH.shape), COUNTED)
    assert rms(still.correction) < 0.3e-3


def test_a_round_that_is_much_worse_is_taken_back() -> None:
    learner = Learner(PATH, PERIOD)
    learner.learn(ROWS, PATH - REPEATING, COUNTED)
    learner.learn(ROWS, PATH - 0.1 * REPEATING, COUNTED)
    best = learner.best.copy()
    far = learner.correction.copy()
    learner.learn(ROWS, PATH - 2 * REPEATING, COUNTED)
    np.testing.assert_allclose(learner.correction, best + (far - best) / 2)


def test_lost_frames_are_bridged_and_a_blind_round_teaches_nothing() -> None:
    whole, holes, blind = (Learner(PATH, PERIOD) for _ in range(3))
    tips = PATH - REPEATING
    whole.learn(ROWS, tips, COUNTED)
    tips = tips.copy()
    tips[300:305] = np.nan
    holes.learn(ROWS, tips, COUNTED)
    np.testing.assert_allclose(holes.correction, whole.correction, atol=2e-5)
    blind.learn(ROWS, np.full_like(PATH, np.nan), COUNTED)
    assert not blind.correction.any()
    assert blind.errors == []


def test_corrections_are_bounded_and_none_at_the_start() -> None:
    learner = Learner(PATH, PERIOD, LearningSettings(largest=5e-3))
    learner.learn(ROWS, PATH - 0.1, COUNTED)
    length = np.linalg.norm(learner.correction, axis=1)
    assert length[0] == 0
    assert length.max() == pytest.approx(5e-3)


def test_a_correction_of_another_path_is_refused() -> None:
    with pytest.raises(InputError, match="correction: 3 targets; valid: 1000"):
        Learner(PATH, PERIOD, correction=np.zeros((3, 3)))


def test_a_correction_in_millimetres_is_refused() -> None:
    """On a robot it would be the first thing to be driven."""
    with pytest.raises(InputError, match=r"correction: up to 40 mm; valid: at most 30 mm \(columns are in m\)"):
        Learner(PATH, PERIOD, correction=np.tile([0.04, 0.0, 0.0], (COUNT, 1)))
