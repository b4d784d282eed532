"""Inputs that excite everything a robot of six muscles and six tendons may hide, as runs of a data set."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.data.datasets import APART
from tepm_opt.data.run import Role
from tepm_opt.data.setpoints import SetPoints

RATE = 50.0  # Hz
LEAD = 0.4  # s of steady inputs before each run
COUNT = 6  # muscles, and tendons
ANGLES = np.deg2rad([90.0, 210.0, 330.0] * 2)

Knots = list[tuple[float, np.ndarray]]
"""Seconds since the knot before, and the levels (15,) reached then: pressures in Pa, tensions and tip force in N."""


@dataclass(frozen=True, eq=False)
class Excitation:
    """A run to be made, which begins at a time in the session in s."""

    file: str
    role: Role
    setpoints: SetPoints
    began: float = 0.0


def excitations(seed: int, short: bool) -> tuple[Excitation, ...]:
    """Runs of a data set.

    Args:
        seed: of the levels and phases that are drawn.
        short: whether there are six runs of 6 … 8 s instead of seven of 20 … 25 s.
    """
    random, slower = np.random.default_rng([seed, 2]), 1.0 if short else 3.0
    low, high = (np.repeat(peaks, 3) for peaks in ((75e3, 110e3), (100e3, 160e3)))
    spread, steps = _spread(slower), _steps(random, 5 if short else 12, 0.5 if short else 1.6)
    fit = {
        "single_pressure": _one_by_one(_level(), (low if short else high) * random.uniform(0.9, 1.1, COUNT), slower, tension=False),
        "single_tension": _one_by_one(_level(140e3), (3.0 if short else 4.5) * random.uniform(0.9, 1.1, COUNT), slower, tension=True),
    }
    fit |= {"elongation": [*spread, *steps]} if short else {"elongation": spread, "steps": [(0.0, _level(90e3)), *steps]}
    fit["tip_load"] = _tip_load(random, slower)
    validation = {"circle": _circle(2, 3.2) if short else _circle(3, 7.0), "mixed": _mixed_sines(random, 6.5 if short else 20.0)}
    roles: dict[Role, dict[str, Knots]] = {"fit": fit, "validation": validation}
    return _one_after_the_other(
        Excitation(f"{name}.csv", role, _sample_knots(knots)) for role, runs in roles.items() for name, knots in runs.items()
    )


def _one_after_the_other(runs: Iterable[Excitation]) -> tuple[Excitation, ...]:
    """Runs of a session."""
    found: list[Excitation] = []
    for run in runs:
        began = found[-1].began + float(found[-1].setpoints.time[-1]) + APART if found else 0.0
        found.append(replace(run, began=began))
    return tuple(found)


def draw_runs(
    random: np.random.Generator, shortest: float, longest: float, fit: int | None = None, judges: int = 2
) -> tuple[Excitation, ...]:
    """Draw runs of random designs, levels and lengths: three to five to fit to and some to judge by.

    Pressures apart and together, tensions and steps or ramps are always among three and more runs to fit to.

    Args:
        random: what is drawn from.
        shortest, longest: length of a run in s.
        fit: how many runs there are to fit to; drawn where None.
        judges: how many there are to judge by.
    """
    count = int(random.integers(3, 6)) if fit is None else fit
    first = [random.choice(kinds) for kinds in (("single_pressure", "elongation"), ("single_tension", "mixed"), ("steps", "ramps"))]
    first = list(random.permutation(first)) if count < len(first) else first
    names = [*first, *random.choice([name for name in DESIGNS if name not in first], max(count - 3, 0), replace=False)][:count]
    judging = random.choice(JUDGES, judges, replace=False)
    runs = []
    for number, name in enumerate(map(str, (*names, *judging)), start=1):
        knots = DESIGNS[name](random, random.uniform(shortest, longest) - LEAD)
        runs.append(Excitation(f"{number}_{name}.csv", "fit" if number <= len(names) else "validation", _sample_knots(knots)))
    return _one_after_the_other(runs)


def thin_run(run: Excitation, every: int) -> Excitation:
    """Thin a run to a part of its sample rate."""
    asked = run.setpoints
    return replace(run, setpoints=SetPoints(asked.time[::every], asked.inputs[::every], asked.tip_force[::every]))


def _level(
    pressure: float | np.ndarray = 0.0, tension: float | np.ndarray = 0.0, force: tuple[float, float, float] = (0, 0, 0)
) -> np.ndarray:
    return np.concatenate([np.broadcast_to(pressure, COUNT), np.broadcast_to(tension, COUNT), force]).astype(float)


def _sample_knots(knots: Knots) -> SetPoints:
    """Linear between the knots, which stand on the grid of the samples; the first level holds for `LEAD`."""
    seconds, levels = zip((LEAD, knots[0][1]), *knots[1:], strict=True)
    at = np.append(0, np.cumsum(np.maximum(np.round(np.multiply(seconds, RATE)), 1)))
    rows, values = np.arange(at[-1] + 1), np.vstack([levels[:1], levels])
    values = np.stack([np.interp(rows, at, column) for column in values.T], axis=1)
    return SetPoints(rows / RATE, values[:, : 2 * COUNT], values[:, 2 * COUNT :])


def _one_by_one(rest: np.ndarray, peaks: np.ndarray, slower: float, tension: bool) -> Knots:
    """One input after the other up, partly down, up again and to zero."""
    knots: Knots = [(0.0, rest)]
    for k, peak in enumerate(peaks):
        for seconds, part in ((0.4, 1.0), (0.3, 0.25), (0.2, 0.7), (0.3, 0.0)):
            level = rest.copy()
            level[k + COUNT * tension] += part * peak
            knots.append((slower * seconds, level))
    return knots


def _ramps(random: np.random.Generator, duration: float) -> Knots:
    """Everything to levels that are drawn, linearly, each in its time; tensions are slack now and then."""
    knots: Knots = [(0.0, _level(random.uniform(60e3, 140e3)))]
    while (left := duration - sum(seconds for seconds, _ in knots)) > 0.1:
        pressures = random.uniform(40e3, 220e3) + random.uniform(-30e3, 30e3, COUNT)
        tensions = random.uniform(0.0, 2.5, COUNT) * (random.uniform(size=COUNT) < 0.6)
        knots.append((min(random.uniform(0.3, 1.6), left), _level(pressures, tensions)))
    return knots


def _spread(slower: float) -> Knots:
    """All muscles together: small turns at low pressure, a large one, a step and a hold."""
    turns = ((0.2, 30e3), (0.2, 8e3), (0.2, 40e3), (0.8, 320e3), (0.7, 60e3), (0.4, 130e3), (0.5, 20e3), (0.02, 90e3), (0.4, 90e3))
    return [(0.0, _level()), *((slower * seconds if seconds > 0.05 else seconds, _level(pressure)) for seconds, pressure in turns)]


def _steps(random: np.random.Generator, count: int, hold: float) -> Knots:
    """Steps of everything, within a sample or two, to levels that are held."""
    knots: Knots = []
    for _ in range(count):
        pressures = random.uniform(50e3, 200e3) + random.uniform(-25e3, 25e3, COUNT)
        level = _level(pressures, random.uniform(0.0, 1.5, COUNT))
        knots += [(0.02 * random.integers(1, 4), level), (hold, level)]
    return knots


def _tip_load(random: np.random.Generator, slower: float) -> Knots:
    """A known tip force that comes, turns and goes, and pressure steps while it acts."""
    still, size = 80e3, random.uniform(0.25, 0.35)
    bent = still + 20e3 * np.cos(ANGLES)
    parts = [
        (0.0, _level(still)),
        (0.6, _level(still, 0, (size, 0, 0))),
        (0.6, _level(still, 0, (size, 0, 0))),
        (0.8, _level(still, 0, (0, size, 0))),
        (0.5, _level(still, 0, (0, size, -0.5))),
        (0.02, _level(bent, 0, (0, size, -0.5))),
        (0.7, _level(bent, 0, (0, size, -0.5))),
        (0.8, _level(still, 0, (-0.7 * size, 0, 0))),
        (0.5, _level(still, 0, (-0.7 * size, 0, 0))),
        (0.4, _level(still)),
        (0.6, _level(still)),
    ]
    return [(slower * seconds if seconds > 0.05 else seconds, level) for seconds, level in parts]


def _circle(turns: int, period: float) -> Knots:
    """Pressures out of phase, so that the tip goes round, and slow tensions against it."""
    time = np.arange(0.0, turns * period + 1e-9, 1 / RATE)
    fade = _fade(time, 0.5 * period)
    pressures = 160e3 + 40e3 * fade * np.cos(2 * np.pi * time[:, None] / period - ANGLES)
    tensions = 0.8 * fade * (1 - np.cos(2 * np.pi * time[:, None] * np.array([1, 1, 2, 2, 1, 3]) / time[-1]))
    return _rows(pressures, tensions)


def _mixed_sines(random: np.random.Generator, duration: float) -> Knots:
    """Sines of several frequencies in all inputs at once: together in the pressures, small ones apart, tensions that reach zero."""
    time = np.arange(0.0, duration + 1e-9, 1 / RATE)

    def sines(hertz: tuple[float, ...], columns: int) -> np.ndarray:
        phase = random.uniform(0, 2 * np.pi, (len(hertz), 1, columns))
        return np.sin(2 * np.pi * np.array(hertz)[:, None, None] * time[None, :, None] + phase).mean(axis=0) * _fade(time, 1.0)

    pressures = 140e3 + 150e3 * sines((0.17, 0.43, 1.1), 1) + 40e3 * sines((0.23, 0.61, 1.9), COUNT)
    return _rows(np.clip(pressures, 5e3, 350e3), np.maximum(2.4 * sines((0.19, 0.53, 1.3), COUNT), 0.0))


Design = Callable[[np.random.Generator, float], Knots]
"""Function of a random generator and a length in s that gives the knots of a run."""


def _singles(tension: bool) -> Design:
    def knots(random: np.random.Generator, duration: float) -> Knots:
        rest, peak = (_level(random.uniform(80e3, 160e3)), 3.5) if tension else (_level(), np.repeat((85e3, 125e3), 3))
        return _one_by_one(rest, peak * random.uniform(0.7, 1.2, COUNT), duration / (1.2 * COUNT), tension)

    return knots


def _random_steps(random: np.random.Generator, duration: float) -> Knots:
    count = int(random.integers(4, 11))
    return [(0.0, _level(random.uniform(60e3, 140e3))), *_steps(random, count, duration / count - 0.04)]


def _turns(random: np.random.Generator, duration: float) -> Knots:
    turns = int(random.integers(1, 4))
    return _circle(turns, duration / turns)


DESIGNS: dict[str, Design] = {
    "single_pressure": _singles(tension=False),
    "single_tension": _singles(tension=True),
    "elongation": lambda random, duration: _spread(duration / 3.2),
    "steps": _random_steps,
    "ramps": _ramps,
    "tip_load": lambda random, duration: _tip_load(random, duration / 5.5),
    "circle": _turns,
    "mixed": _mixed_sines,
}
JUDGES = ("circle", "mixed", "steps", "ramps")
"""Designs of the runs to judge by."""


def _fade(time: np.ndarray, within: float) -> np.ndarray:
    """From 0 to 1, smoothly, (rows, 1)."""
    part = np.clip(time[:, None] / within, 0.0, 1.0)
    return part**2 * (3 - 2 * part)


def _rows(pressures: np.ndarray, tensions: np.ndarray) -> Knots:
    return [(1 / RATE, _level(*row)) for row in zip(pressures, tensions, strict=True)]
