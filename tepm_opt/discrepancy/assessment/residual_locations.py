"""Locations of residuals: runs, points, inputs, moments and frequencies in which they hold more than noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.fft import dct
from scipy.special import chdtrc

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.assessment.location_sentence import describe_locations
from tepm_opt.discrepancy.assessment.residual_samples import Found, ResidualSamples, collect_samples
from tepm_opt.discrepancy.assessment.result import Place
from tepm_opt.discrepancy.assessment.row_choices import Choice, list_choices
from tepm_opt.discrepancy.assessment.settings import DEFAULT, AssessmentSettings
from tepm_opt.solvers.numerics.text import quantity


@dataclass(frozen=True, eq=False)
class Localisation:
    """Parts of the data in which the model misses.

    Attributes:
        places: all that were looked at; the telling ones first, then the others, each with the largest structure first.
        telling: number of those that hold clearly more than elsewhere and cannot be chance.
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


def localise(
    runs: Sequence[Run], points: Sequence[np.ndarray], noise: float | np.ndarray, signals: Signals, static: bool, seed: int,
    block: float | None = None, settings: AssessmentSettings = DEFAULT,
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
        block: length of the blocks in s; the settings' where None.
        settings: thresholds.
    """
    residuals, unit = [run.points - modelled for run, modelled in zip(runs, points, strict=True)], error_unit(signals, noise)
    if np.ndim(noise):
        residuals, noise = [residual / noise for residual in residuals], 1.0
    block, short = settings.location_block if block is None else block, settings.location_block
    samples = collect_samples(runs, residuals, float(noise), None if static else block, unit, settings)
    random, found = np.random.default_rng(seed), list[Found]()
    if samples.count:
        found = _locate_rows(samples, list(list_choices(runs, points, signals, static, settings)), random)
        found += _locate_columns(samples, signals, random)
    if samples.count and not static:
        found += _locate_bands(samples, runs, residuals)
        fine = samples if block <= short else collect_samples(runs, residuals, float(noise), short, unit, settings)
        moment = _find_moment(fine, runs)  # an event is short
        found += [] if moment is None else _locate_rows(fine, [moment], random)
    return _summarise(found, samples, runs, signals)


def error_unit(signals: Signals, noise: float | np.ndarray) -> str:
    """Unit of errors: that of what is measured; quantities with a noise each are compared by it."""
    return signals.unit if np.ndim(noise) == 0 else "times the noise"


def _summarise(found: list[Found], samples: ResidualSamples, runs: Sequence[Run], signals: Signals) -> Localisation:
    """Places in order, with the structure of all data and the answer in words."""
    ordered = sorted(found, key=lambda entry: (not entry[1], -entry[0].rms))
    places = tuple(place for place, _ in ordered)
    telling = [place for place, tells in ordered if tells]
    rms = float(np.sqrt(samples.axes * max(samples.density, 0.0)))
    if telling or samples.is_clear(samples.density, samples.count):
        sentence = describe_locations(rms, telling, places, samples.unit, signals, samples.settings)
    elif samples.count:
        sentence = f"No structure above the noise ({quantity(float(np.sqrt(samples.axes * samples.variance)), samples.unit)})."
    else:
        sentence = "No sample can be compared with the model."
    return Localisation(places, len(telling), _heat(samples), tuple(run.file for run in runs), signals.points, rms, sentence)


def _heat(samples: ResidualSamples) -> np.ndarray:
    """Structure of every point in every run in m, (runs, points)."""
    parts = [slice(*pair) for pair in zip(samples.starts[:-1], samples.starts[1:], strict=True)]
    excess = np.array([samples.excess[rows].sum(axis=(0, 2)) for rows in parts])
    count = np.array([samples.present[rows].sum(axis=(0, 2)) for rows in parts])
    return np.where(count > 0, np.sqrt(samples.axes * np.maximum(excess, 0.0) / np.maximum(count, 1)), np.nan)


def _locate_rows(samples: ResidualSamples, labels: list[Choice], random: np.random.Generator) -> list[Found]:
    """Places that are a choice of rows."""
    masks = np.array([rows for _, _, rows in labels])
    chances = _row_chances(samples, masks, random)
    excess = masks @ samples.excess.sum(axis=(1, 2))
    count = masks @ samples.present.sum(axis=(1, 2))
    places = zip(labels, excess, count, chances, strict=True)
    return [samples.make_place(by, name, float(e), float(n), float(p)) for (by, name, _), e, n, p in places if n]


def _row_chances(samples: ResidualSamples, masks: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Share of orders of the blocks that concentrate as much in each mask (masks, rows): (masks,)."""
    excess, count = (values.sum(axis=(1, 2)) for values in samples.blocks)
    rows = np.bincount(samples.block)
    within = np.array([np.bincount(samples.block, mask) / rows for mask in masks])  # part of every block

    def density(order: np.ndarray) -> np.ndarray:
        return (excess[order] @ within.T) / np.maximum(count[order] @ within.T, 1e-9)

    seen, exceeded = density(np.arange(len(rows))[None])[0], np.zeros(len(masks))
    for size in _chunks(len(rows), samples.settings):
        exceeded += (density(random.random((size, len(rows))).argsort(axis=1)) >= seen - 1e-9 * abs(seen)).sum(axis=0)
    return (1 + exceeded) / (1 + samples.settings.location_permutations)


def _locate_columns(samples: ResidualSamples, signals: Signals, random: np.random.Generator) -> list[Found]:
    """Places by reference point and by axis."""
    found = []
    for by, names, axis in (("point", signals.points, 2), ("axis", signals.axes, 1)):
        if len(names) < 2:
            continue
        excess, count = (values.sum(axis=axis) for values in samples.blocks)
        chances = _column_chances(excess, count, random, samples.settings)
        for name, e, n, p in zip(names, excess.sum(axis=0), count.sum(axis=0), chances, strict=True):
            rms = float(np.sqrt(max(e, 0.0) / n)) if by == "axis" and n else None  # squares of the axes add up to those of Eq. (5)
            found += [samples.make_place(by, name, float(e), float(n), float(p), rms)] if n else []
    return found


def _column_chances(excess: np.ndarray, count: np.ndarray, random: np.random.Generator, settings: AssessmentSettings) -> np.ndarray:
    """Share of orders of the columns within every block that concentrate as much in one: (columns,)."""
    seen, exceeded = excess.sum(axis=0) / np.maximum(count.sum(axis=0), 1), np.zeros(excess.shape[1])
    for size in _chunks(excess.size, settings):
        order = random.random((size, *excess.shape)).argsort(axis=2)
        permuted = np.take_along_axis(excess[None], order, axis=2).sum(axis=1)
        counted = np.take_along_axis(count[None], order, axis=2).sum(axis=1)
        exceeded += (permuted / np.maximum(counted, 1) >= seen - 1e-9 * abs(seen)).sum(axis=0)
    return (1 + exceeded) / (1 + settings.location_permutations)


def _chunks(size: int, settings: AssessmentSettings) -> Iterator[int]:
    """Numbers of permutations to make at once, of so many values each."""
    most, left = max(1, settings.location_chunk // max(size, 1)), settings.location_permutations
    while left:
        yield min(most, left)
        left -= min(most, left)


def _locate_bands(samples: ResidualSamples, runs: Sequence[Run], residuals: Sequence[np.ndarray]) -> list[Found]:
    """Places by frequency; chances are those of white noise."""
    edges = samples.settings.location_bands
    between = [f"{low:g} to {high:g} Hz" for low, high in pairwise(edges)]
    names = [f"below {edges[0]:g} Hz", *between, f"above {edges[-1]:g} Hz"]
    energy, count = np.zeros(len(names)), np.zeros(len(names))
    for run, residual in zip(runs, residuals, strict=True):
        for series in residual.reshape(run.rows, -1).T:
            squares, frequency = _spectrum(run.time, series)
            band, known = np.digitize(frequency, edges), np.isfinite(series).mean()
            energy += known * np.bincount(band, squares, len(names))
            count += known * np.bincount(band, minlength=len(names))
    found, rarest = [], 1 / (1 + samples.settings.location_permutations)
    for name, e, n in zip(names, energy, count, strict=True):
        if n:
            chance = float(chdtrc(n, e / samples.variance)) if samples.variance > 0 else float(e <= 0)
            excess = float(e - n * samples.variance)
            rms = float(np.sqrt(samples.axes * max(excess, 0.0) / samples.count))  # squares of the bands add up to the whole
            found.append(samples.make_place("band", name, excess, float(n), max(chance, rarest), rms))
    return found


def _find_moment(samples: ResidualSamples, runs: Sequence[Run]) -> Choice | None:
    """The stretch of time that holds most in least, as if an event happened that nobody noted; None where none stands out."""
    limits = samples.settings
    excess, count = (values.sum(axis=(1, 2)) for values in samples.blocks)
    run = np.searchsorted(samples.starts, np.flatnonzero(np.diff(samples.block, prepend=-1)), side="right") - 1
    held, seen = (
        np.append(0.0, np.cumsum(values)) / max(values.sum(), np.finfo(float).tiny) for values in (np.maximum(excess, 0.0), count)
    )
    best = (0.0, 0, 0)
    for length in (length for length in (1, 2, 4, 8, 16) if length < len(run)):  # blocks
        share, part = held[length:] - held[:-length], seen[length:] - seen[:-length]
        share = np.where(run[length - 1 :] == run[: len(run) - length + 1], share, 0.0)
        ratio = share / np.maximum(part, 1e-12)
        stands_out = (share >= limits.moment_min_share) & (ratio >= limits.moment_min_ratio)
        weight = np.where(stands_out, share * np.log(np.maximum(ratio, 1.0)), 0.0)
        best = max(best, (float(weight.max()), int(weight.argmax()), length))
    weight, first, length = best
    if not weight:
        return None
    rows = (samples.block >= first) & (samples.block < first + length)
    time = runs[run[first]].time[np.flatnonzero(rows) - samples.starts[run[first]]]
    return "moment", f"{time[0]:.4g} s to {time[-1]:.4g} s of {runs[run[first]].file}", rows


def _spectrum(time: np.ndarray, series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squares of the orthonormal cosine transform, which bears that ends differ, and frequency of each in Hz; missing interpolated."""
    present = np.isfinite(series)
    if present.sum() < 2:
        return np.zeros(0), np.zeros(0)
    even = np.linspace(time[0], time[-1], len(time))
    squares = np.asarray(dct(np.interp(even, time[present], series[present]), norm="ortho")) ** 2
    return squares, np.arange(len(time)) * (len(time) - 1) / (2 * len(time) * (time[-1] - time[0]))
