"""Thresholds of the assessment of hypotheses and residuals."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AssessmentSettings:
    """Thresholds for credibility, constancy, locations of residuals, choices of rows and the black box.

    Attributes:
        min_named: probability from which an effect is named: that it is a cause, and it rather than its rivals; 0.5 to 1.
        min_sure: stated probability, after calibration, from which an effect counts as settled, 0.5 to 1.
        calibration_offset, calibration_own, calibration_weakest: offset and weights of log odds of `calibration`, fitted by the log score
            of 269 blind trials of seeds 40261 and 51107; 95 % intervals -1.61 … 0.59, 0.03 … 1.00, 0.32 … 1.37.
        interval_factor: factor on the standard deviations of effects' parameters, of the same trials: 92 of 98 intervals hold the truth
            then, 79 of 98 without it.
        min_rival: probability from which a rival counts, 0 to 1.
        min_scored: score from which `stated_set.score_causes` keeps a candidate, 0 to 1.
        min_stated: score from which a candidate is in the set of causes that are not ruled out, 0 to 1; the set holds all
            that acts in 95 % of trials of the kind it was calibrated on: 65 blind trials, two of which have less.
        min_gap_closed: share of the squared gap on runs not used that the effects must close, 0 to 1.
        min_gap_closed_absent: the same with effects left out of runs that do not show them; more, as those runs have shown that.
        scatter_even_odds: chance of a pattern at which it is as likely as not that scatter is something else, 0 to 1.
        beside_max_excess: share of the excess that a force by place or speed may leave beside an effect for that to be doubted, 0 to 1.
        noise_excess: excess that noise may seem to have which is a little more than was assumed; noise is known to half a percent.
        spread_even_odds: spread of an effect's sizes over its size at which it is as likely as not a cause; positive.
        spread_remark: spread of sizes that is worth a remark; positive.
        visible_excess: mean square over the noise's by which an effect must change a segment of the data to be sized there.
        location_permutations: permutations of a test of significance; 999 resolve chances of 0.001.
        location_chunk: numbers permuted at a time, which bounds memory.
        location_block: length of the blocks of time in s that are permuted; also of those in which single events are sought.
        location_max_chance: chance below which a place is significant, 0 to 1.
        location_min_ratio, location_min_share: density over that everywhere, and share of the structure. Below these a place says little
            although it is significant.
        location_min_excess, location_min_sigmas: squared structure over the noise's that counts: at least this, and this many standard
            deviations of the noise.
        location_bands: edges of the frequency bands in Hz, rising.
        band_min_share: share of the structure in a band; larger, as every error that varies smoothly is densest in the slow band.
        moment_min_ratio, moment_min_share: the same for an event; what is less may be chance of the motion.
        location_max_others: share of what the most telling actuator tells up to which others may tell for it to be named, 0 to 1.
        rows_recent: time in s that an input or a point counts as moving after it did.
        rows_in_use: share of an input's range above which it is in use, 0 to 1.
        rows_moved: share of a signal's range passed within `rows_recent` from which it moves, 0 to 1.
        rows_reversal: share of an input's range that it must come back by to have reversed; more than jitter.
        rows_point_moved: way in m within `rows_recent` from which a point moves.
        black_box_samples: samples a Gaussian process learns from; it costs their cube.
        black_box_memory: time constant in s of the low-passed inputs that stand for the past.
    """

    min_named: float = 0.8
    min_sure: float = 0.7
    calibration_offset: float = -0.38
    calibration_own: float = 0.39
    calibration_weakest: float = 0.59
    interval_factor: float = 1.6
    min_rival: float = 0.1
    min_scored: float = 0.01
    min_stated: float = 0.1
    min_gap_closed: float = 0.1
    min_gap_closed_absent: float = 0.9
    scatter_even_odds: float = 0.002
    beside_max_excess: float = 0.7
    noise_excess: float = 0.015
    spread_even_odds: float = 0.5
    spread_remark: float = 0.3
    visible_excess: float = 0.05
    location_permutations: int = 999
    location_chunk: int = 2_000_000
    location_block: float = 1.0
    location_max_chance: float = 0.01
    location_min_ratio: float = 1.25
    location_min_share: float = 0.05
    location_min_excess: float = 0.05
    location_min_sigmas: float = 5.0
    location_bands: tuple[float, ...] = (0.3, 2.0)
    band_min_share: float = 0.2
    moment_min_ratio: float = 10.0
    moment_min_share: float = 0.2
    location_max_others: float = 0.7
    rows_recent: float = 1.0
    rows_in_use: float = 0.02
    rows_moved: float = 0.005
    rows_reversal: float = 0.01
    rows_point_moved: float = 1e-3
    black_box_samples: int = 400
    black_box_memory: float = 0.3


DEFAULT = AssessmentSettings()
