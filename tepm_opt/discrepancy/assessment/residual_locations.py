"""Where a model misses: in which runs, points, inputs, moments and frequencies the residuals hold more than noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import dct
from scipy.special import chdtrc

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.assessment.result import Place
from tepm_opt.discrepancy.assessment.row_choices import ALONE, Choice, choices
from tepm_opt.solvers.text import quantity

PERMUTATIONS = 999
CHUNK = 2_000_000  # numbers permuted at a time
BLOCK = 1.0  # s
SIGNIFICANT = 0.01
LEAST_RATIO, LEAST_SHARE = 1.25, 0.05  # below these a place says little although it is significant
LEAST_EXCESS, SIGMAS = 0.05, 5.0  # squared structure over the noise's that counts: at least this, and this many deviations of the noise

EDGES = (0.3, 2.0)  # Hz
BANDS = ("below 0.3 Hz", "0.3 to 2 Hz", "above 2 Hz")
TIMES_NOISE = "times the noise"
LEAST_BAND_SHARE = 0.2  # every error that varies smoothly is densest in the slow band
LEAST_MOMENT_SHARE, LEAST_MOMENT_RATIO = 0.2, 10.0  # what is less may be chance of the motion; more is as if something else had happened
MOMENTS = (1, 2, 4, 8, 16)  # blocks of time


STANDS_OUT = 0.7  # part of what one actuator tells up to which others may tell for it to be named

LEAST_OF = {"band": (LEAST_RATIO, LEAST_BAND_SHARE), "moment": (LEAST_MOMENT_RATIO, LEAST_MOMENT_SHARE)}
"""Ratio and share below which a place of this kind says little."""


@dataclass(frozen=True, eq=False)
class Localisation:
    """Where the model misses.

    Attributes:
        places: all that were looked at; the telling ones first, then the others, each with the largest structure first.
        telling: how many of them hold clearly more than elsewhere and cannot be chance.
        heat: structure of every point in every run, root mean square of Eq. (5) in m with the noise taken off, (runs, points); NaN
            where nothing was measured.
        runs: names of its rows.
        points: names of its columns.
        rms: structure of all data in m, the same measure.
        sentence: the answer in words.
    """

    places: tuple[Place, ...]
    telling: int
    heat: np.ndarray
    runs: tuple[str, ...]
    points: tuple[str, ...]
    rms: float
    sentence: str

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Localisation({1e3 * self.rms:.3g} mm beyond the noise, {self.telling} of {len(self.places)} places tell)"


@dataclass(frozen=True, eq=False)
class _Samples:
    """Residuals of all runs, one below the other.

    Attributes:
        excess: squared residual less the noise's square, (rows, points, 3) in m²; 0 where missing.
        present: whether there is a sample, (rows, points, 3).
        block: number of each row's block of time, (rows,).
        starts: first row of every run, and the number of rows, (runs + 1,).
        variance: of the noise in m².
        unit: of residuals; m unless what is measured has another.
    """

    excess: np.ndarray
    present: np.ndarray
    block: np.ndarray
    starts: np.ndarray
    variance: float
    unit: str = "m"

    @cached_property
    def axes(self) -> float:
        """Coordinates measured of a point that was, on average."""
        return self.count / max(int(self.present.any(axis=2).sum()), 1)

    @cached_property
    def count(self) -> int:
        """Coordinates measured."""
        return int(self.present.sum())

    @cached_property
    def density(self) -> float:
        """Mean square beyond the noise's of a coordinate in m²."""
        return float(self.excess.sum()) / max(self.count, 1)

    @cached_property
    def blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """Excess and number of coordinates of every block, (blocks, points, 3) each."""
        starts = np.flatnonzero(np.diff(self.block, prepend=-1))
        return np.add.reduceat(self.excess, starts), np.add.reduceat(self.present.astype(float), starts)

    @cached_property
    def scale(self) -> float:
        """The density, or what noise can make of it where that is more: what ratios and shares refer to, in m²."""
        return max(self.density, self.variance * float(np.sqrt(2 / max(self.count, 1))), np.finfo(float).tiny)

    def found(self, by: str, name: str, excess: float, count: float, p: float, rms: float | None = None) -> _Found:
        """A place with a sum of squares beyond the noise's, in m², in so many coordinates."""
        density = max(excess / count, 0.0)
        share = min(density * count / (self.scale * self.count), 1.0)
        rms = float(np.sqrt(self.axes * density)) if rms is None else rms
        return _Found(Place(by, name, rms, share, density / self.scale, p), self.clear(density, count))

    def clear(self, density: float, count: float) -> bool:
        """Whether so much per coordinate, in m², is beyond what noise of the assumed size leaves."""
        return count > 0 and density > self.variance * max(LEAST_EXCESS, SIGMAS * float(np.sqrt(2 / count)))


@dataclass(frozen=True)
class _Found:
    """A place, and whether what it holds is clearly more than noise."""

    place: Place
    clear: bool

    @property
    def tells(self) -> bool:
        """Whether it holds clearly more than elsewhere, and not by chance."""
        place = self.place
        ratio, share = LEAST_OF.get(place.by, (LEAST_RATIO, LEAST_SHARE))
        return self.clear and place.p <= SIGNIFICANT and place.ratio >= ratio and place.share >= share


def localise(
    runs: Sequence[Run], points: Sequence[np.ndarray], noise: float | np.ndarray, signals: Signals, static: bool, seed: int,
    block: float = BLOCK,
) -> Localisation:  # fmt: skip
    """Find the parts of the data in which measured and modelled positions differ by more than noise.

    Significance is against data with permuted blocks of time (for points and axes: with their order permuted within every block; for
    frequency bands: against white noise). Samples that are missing, and rows without a prediction, do not count.

    Args:
        runs: measured.
        points: modelled reference points of every run, (rows, points, 3) in m.
        noise: standard deviation of what is measured, per axis in m; or of each point, (points, 1).
        signals: names and ranges.
        static: whether rows are equilibria: each is a block, and there are no places in time.
        seed: of the permutations.
        block: length of the blocks in s.
    """
    residuals, unit = [run.points - modelled for run, modelled in zip(runs, points, strict=True)], signals.unit
    if np.ndim(noise):  # quantities of different kinds are compared by their noise
        residuals, noise, unit = [residual / noise for residual in residuals], 1.0, TIMES_NOISE
    samples, random = _samples(runs, residuals, float(noise), None if static else block, unit), np.random.default_rng(seed)
    found = []
    if samples.count:
        found = _rows(samples, list(choices(runs, points, signals, static)), random) + _columns(samples, signals, random)
        found += [] if static else _bands(samples, runs, residuals)
        fine = samples if static or block <= BLOCK else _samples(runs, residuals, float(noise), BLOCK, unit)  # what happens once is short
        moments = [] if static else list(_moments(fine, runs))
        found += _rows(fine, moments, random) if moments else []
    return _localisation(found, samples, runs, signals)


def _samples(runs: Sequence[Run], residuals: Sequence[np.ndarray], noise: float, block: float | None, unit: str) -> _Samples:
    every = np.concatenate(residuals)
    present = np.isfinite(every)
    excess = np.where(present, np.where(present, every, 0.0) ** 2 - noise**2, 0.0)
    blocks, first = [], 0
    for run in runs:
        number = np.arange(run.rows) if block is None else np.floor((run.time - run.time[:1]) / block + 1e-9).astype(int)
        number = np.unique(number, return_inverse=True)[1]
        blocks.append(first + number)
        first += int(number.max(initial=-1)) + 1
    return _Samples(excess, present, np.concatenate(blocks), np.cumsum([0, *(run.rows for run in runs)]), noise**2, unit)


def _localisation(found: list[_Found], samples: _Samples, runs: Sequence[Run], signals: Signals) -> Localisation:
    ordered = sorted(found, key=lambda entry: (not entry.tells, -entry.place.rms))
    places = tuple(entry.place for entry in ordered)
    telling = [entry.place for entry in ordered if entry.tells]
    rms, structured = float(np.sqrt(samples.axes * max(samples.density, 0.0))), samples.clear(samples.density, samples.count)
    sentence = _sentence(rms, telling, places, samples.unit, signals) if telling or structured else _nothing(samples)
    return Localisation(places, len(telling), _heat(samples), tuple(run.file for run in runs), signals.points, rms, sentence)


def _heat(samples: _Samples) -> np.ndarray:
    """Structure of every point in every run in m, (runs, points)."""
    parts = [slice(*pair) for pair in zip(samples.starts[:-1], samples.starts[1:], strict=True)]
    excess = np.array([samples.excess[rows].sum(axis=(0, 2)) for rows in parts])
    count = np.array([samples.present[rows].sum(axis=(0, 2)) for rows in parts])
    return np.where(count > 0, np.sqrt(samples.axes * np.maximum(excess, 0.0) / np.maximum(count, 1)), np.nan)


def _rows(samples: _Samples, labels: list[Choice], random: np.random.Generator) -> list[_Found]:
    """Places that are a choice of rows."""
    masks = np.array([rows for _, _, rows in labels])
    chances = _chances_of_rows(samples, masks, random)
    excess = masks @ samples.excess.sum(axis=(1, 2))
    count = masks @ samples.present.sum(axis=(1, 2))
    places = zip(labels, excess, count, chances, strict=True)
    return [samples.found(by, name, float(e), float(n), float(p)) for (by, name, _), e, n, p in places if n]


def _chances_of_rows(samples: _Samples, masks: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """How often blocks in another order concentrate as much in each mask (masks, rows): (masks,)."""
    excess, count = (values.sum(axis=(1, 2)) for values in samples.blocks)
    rows = np.bincount(samples.block)
    within = np.array([np.bincount(samples.block, mask) / rows for mask in masks])  # part of every block

    def density(order: np.ndarray) -> np.ndarray:
        return (excess[order] @ within.T) / np.maximum(count[order] @ within.T, 1e-9)

    seen, exceeded = density(np.arange(len(rows))[None])[0], np.zeros(len(masks))
    for size in _chunks(len(rows)):
        exceeded += (density(random.random((size, len(rows))).argsort(axis=1)) >= seen - 1e-9 * abs(seen)).sum(axis=0)
    return (1 + exceeded) / (1 + PERMUTATIONS)


def _columns(samples: _Samples, signals: Signals, random: np.random.Generator) -> list[_Found]:
    """Places by reference point and by axis."""
    found = []
    for by, names, axis in (("point", signals.points, 2), ("axis", signals.axes, 1)):
        if len(names) < 2:
            continue
        excess, count = (values.sum(axis=axis) for values in samples.blocks)
        chances = _chances_of_columns(excess, count, random)
        for name, e, n, p in zip(names, excess.sum(axis=0), count.sum(axis=0), chances, strict=True):
            rms = float(np.sqrt(max(e, 0.0) / n)) if by == "axis" and n else None  # squares of the axes add up to those of Eq. (5)
            found += [samples.found(by, name, float(e), float(n), float(p), rms)] if n else []
    return found


def _chances_of_columns(excess: np.ndarray, count: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """How often columns in another order within every block concentrate as much in one: (columns,) from (blocks, columns)."""
    seen, exceeded = excess.sum(axis=0) / np.maximum(count.sum(axis=0), 1), np.zeros(excess.shape[1])
    for size in _chunks(excess.size):
        order = random.random((size, *excess.shape)).argsort(axis=2)
        permuted = np.take_along_axis(excess[None], order, axis=2).sum(axis=1)
        counted = np.take_along_axis(count[None], order, axis=2).sum(axis=1)
        exceeded += (permuted / np.maximum(counted, 1) >= seen - 1e-9 * abs(seen)).sum(axis=0)
    return (1 + exceeded) / (1 + PERMUTATIONS)


def _chunks(size: int) -> Iterator[int]:
    """Permutations to make at once, all together `PERMUTATIONS`."""
    most, left = max(1, CHUNK // max(size, 1)), PERMUTATIONS
    while left:
        yield min(most, left)
        left -= min(most, left)


def _bands(samples: _Samples, runs: Sequence[Run], residuals: Sequence[np.ndarray]) -> list[_Found]:
    """Places by frequency; chances are those of white noise."""
    energy, count = np.zeros(len(BANDS)), np.zeros(len(BANDS))
    for run, residual in zip(runs, residuals, strict=True):
        for series in residual.reshape(run.rows, -1).T:
            squares, band = _spectrum(run.time, series)
            known = np.isfinite(series).mean()
            energy += known * np.bincount(band, squares, len(BANDS))
            count += known * np.bincount(band, minlength=len(BANDS))
    found = []
    for name, e, n in zip(BANDS, energy, count, strict=True):
        if n:
            chance = float(chdtrc(n, e / samples.variance)) if samples.variance > 0 else float(e <= 0)
            excess = float(e - n * samples.variance)
            rms = float(np.sqrt(samples.axes * max(excess, 0.0) / samples.count))  # squares of the bands add up to the whole
            found.append(samples.found("band", name, excess, float(n), max(chance, 1 / (1 + PERMUTATIONS)), rms))
    return found


def _moments(samples: _Samples, runs: Sequence[Run]) -> Iterator[Choice]:
    """The stretch of time that holds most in least, where it is as if something had happened then that nobody noted."""
    excess, count = (values.sum(axis=(1, 2)) for values in samples.blocks)
    run = np.searchsorted(samples.starts, np.flatnonzero(np.diff(samples.block, prepend=-1)), side="right") - 1
    held, seen = (
        np.append(0.0, np.cumsum(values)) / max(values.sum(), np.finfo(float).tiny) for values in (np.maximum(excess, 0.0), count)
    )
    best = (0.0, 0, 0)
    for length in (length for length in MOMENTS if length < len(run)):
        share, part = held[length:] - held[:-length], seen[length:] - seen[:-length]
        share = np.where(run[length - 1 :] == run[: len(run) - length + 1], share, 0.0)
        ratio = share / np.maximum(part, 1e-12)
        weight = np.where((share >= LEAST_MOMENT_SHARE) & (ratio >= LEAST_MOMENT_RATIO), share * np.log(np.maximum(ratio, 1.0)), 0.0)
        best = max(best, (float(weight.max()), int(weight.argmax()), length))
    weight, first, length = best
    if weight:
        rows = (samples.block >= first) & (samples.block < first + length)
        time = runs[run[first]].time[np.flatnonzero(rows) - samples.starts[run[first]]]
        yield "moment", f"{time[0]:.4g} s to {time[-1]:.4g} s of {runs[run[first]].file}", rows


def _spectrum(time: np.ndarray, series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squares of the orthonormal cosine transform, which does not mind that ends differ, and the band of each; missing interpolated."""
    present = np.isfinite(series)
    if present.sum() < 2:
        return np.zeros(0), np.zeros(0, dtype=int)
    even = np.linspace(time[0], time[-1], len(time))
    squares = np.asarray(dct(np.interp(even, time[present], series[present]), norm="ortho")) ** 2
    frequency = np.arange(len(time)) * (len(time) - 1) / (2 * len(time) * (time[-1] - time[0]))
    return squares, np.digitize(frequency, EDGES)


def _nothing(samples: _Samples) -> str:
    if not samples.count:
        return "No sample can be compared with the model."
    return f"No structure above the noise ({quantity(float(np.sqrt(samples.axes * samples.variance)), samples.unit)})."


def _sentence(rms: float, telling: Sequence[Place], found: Sequence[Place], unit: str, signals: Signals) -> str:
    best = {by: max((t for t in telling if t.by == by), key=_weight) for by in {t.by for t in telling}}
    spots = [f"in {best['run'].name} ({quantity(best['run'].rms, unit)})"] if "run" in best else []
    spots += [f"at {best['point'].name}" + ("" if spots else f" ({quantity(best['point'].rms, unit)})")] if "point" in best else []
    parts = [f"The model misses by {quantity(rms, unit)} beyond the noise" + (f", most {' and '.join(spots)}" if spots else "")]
    parts += [f"along {best['axis'].name}"] if "axis" in best else []
    parts += _used(best, telling, found)
    parts += [*_regimes(telling, found, unit, signals), *_times(best)]
    parts += [f"{100 * best['band'].share:.0f} % of it {best['band'].name}"] if "band" in best else []
    return "; ".join(parts if len(parts) > 1 or spots else [parts[0] + ", everywhere alike"]) + "."


def _used(best: dict[str, Place], telling: Sequence[Place], found: Sequence[Place]) -> list[str]:
    """What is in use where the model misses more, as far as it stands out against what is like it; all of a kind where all tell alike."""
    for by in ("actuator", "module", "input"):
        if by not in best:
            continue
        name, _, kind = best[by].name.removesuffix(ALONE).partition(" ")
        alike = [place for place in found if place.by == by and (by != "actuator" or place.name.removesuffix(ALONE).endswith(f" {kind}"))]
        others = [place for place in alike if place.name.removesuffix(ALONE) != best[by].name.removesuffix(ALONE)]
        if all(_weight(place) <= STANDS_OUT * _weight(best[by]) for place in others):
            alone = " and no other" if best[by].name.endswith(ALONE) else ""
            return [f"while {name}'s {kind}{alone} is in use" if by == "actuator" else f"while {best[by].name} is in use"]
        if by == "actuator" and {place.name for place in alike if not place.name.endswith(ALONE)} <= {place.name for place in telling}:
            return [f"while {kind}s are in use"]
    return []


def _weight(place: Place) -> float:
    """How much a place tells: it holds much of the structure in little of the data."""
    return place.share * float(np.log(max(place.ratio, 1e-9)))


def _regimes(telling: Sequence[Place], found: Sequence[Place], unit: str, signals: Signals) -> list[str]:
    regimes = {place.name: place for place in found if place.by == "regime"}
    words = []
    if "at rest" in regimes and "moving" in regimes:
        rest, moving = regimes["at rest"], regimes["moving"]
        if rest.rms > 1.5 * moving.rms:
            words = (
                [f"more at rest ({quantity(rest.rms, unit)}) than in motion ({quantity(moving.rms, unit)})"]
                if rest.p <= SIGNIFICANT
                else []
            )
        elif moving.rms > 1.5 * rest.rms:
            words = (
                [f"more in motion ({quantity(moving.rms, unit)}) than at rest ({quantity(rest.rms, unit)})"]
                if moving.p <= SIGNIFICANT
                else []
            )
        else:
            words = ["at rest as much as in motion"]
    named = {"after a reversal": "after reversals", **{regime.name: regime.when for regime in signals.regimes}}
    return words + [f"more {when}" for name, when in named.items() if any(t.by == "regime" and t.name == name for t in telling)]


def _times(best: dict[str, Place]) -> list[str]:
    words = {"early": "more at the start of the runs", "middle": "more in the middle of the runs", "late": "more at the end of the runs"}
    moment = [f"{100 * best['moment'].share:.0f} % of it from {best['moment'].name}"] if "moment" in best else []
    return [words[best["time"].name], *moment] if "time" in best else moment
