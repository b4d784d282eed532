"""Thresholds of the checks that data pass before the search."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PreparationSettings:
    """Thresholds for noise, clock, pressure regulators and beginnings of runs. Squares and ratios are over the assumed noise.

    Attributes:
        noise_block_rows: rows of a block of the noise estimate; at least 10, so that a block shows the motion but few are lost to it.
        noise_min_blocks: blocks of a coordinate from which its noise is estimated; at least 2.
        noise_min_differences: third differences from which a block counts; 1 to `noise_block_rows`.
        noise_rough_block: times the median square of blocks above which a block holds more than noise and is left out; above 1.
        noise_white_tolerance: relative change with the distance between samples up to which noise is white, 0 to 1.
        noise_motion_tolerance: logarithm of the noise in motion over that at rest up to which it is alike; not negative.
        noise_above_sigmas, noise_below_sigmas: standard errors from which noise is larger, or smaller, than assumed. Smaller noise needs
            more, as it makes structure of what was none.
        noise_min_change: relative departure from the assumed noise below which nothing is changed, 0 to 1.
        noise_min_ratio: measured over assumed noise below which the assumed one is kept, 0 to 1. Whoever declares far more than what
            scatters means more than white noise.
        clock_max_shift: longest shift searched, in s.
        clock_max_lead, clock_max_lag: shifts in s that may be the machine's: positions lead or trail the model's by at most this.
        clock_min_explained: share of the structure of all runs that a shift must explain, 0 to 1.
        clock_min_explained_alone: the same in a single run; larger, as a model that is far off fits some run better at another time.
        clock_min_lag_ratio: times the squares after the shift that every first-order lag must leave; at least 1.
        clock_min_structure: mean square beyond the noise's from which a shift is sought.
        clock_min_motion: range of the modelled motion, times the noise, from which a run can tell.
        regulator_step: time step of simulated regulators in s; well below their time constants.
        regulator_substeps: parts of a time step, or of the time between rows, in which stairs are sampled; at least 1.
        regulator_max_remaining: share of the squares that a further property of a device may leave at most to be there, 0 to 1.
        regulator_max_noise: times the gauge's noise that may be left; at least 1.
        regulator_exact: share of the deviation without a lag that may be left however little noise there is, 0 to 1.
        regulator_range_sigmas, regulator_range_share: half-width of the range of a time constant that is searched further, in standard
            deviations and relative to the time constant; the larger of the two counts.
        regulator_min_delay: delay in s below which there is none. By this a delay may be longer than gauges show, as the body's
            sluggishness looks like one.
        beginning_block: length of the blocks in s whose misfit is compared.
        beginning_min_misfit: times the median block's mean square from which a block at a beginning is left out; above 1.
        beginning_max_motion: times the run's mean square about its mean up to which a beginning counts as no more lively.
        beginning_max_share: share of a run that may be left out, 0 to 1.
    """

    noise_block_rows: int = 50
    noise_min_blocks: int = 8
    noise_min_differences: int = 10
    noise_rough_block: float = 2.5
    noise_white_tolerance: float = 0.1
    noise_motion_tolerance: float = 0.2
    noise_above_sigmas: float = 2.0
    noise_below_sigmas: float = 3.0
    noise_min_change: float = 0.005
    noise_min_ratio: float = 0.4
    clock_max_shift: float = 5.0
    clock_max_lead: float = 0.03
    clock_max_lag: float = 0.25
    clock_min_explained: float = 0.6
    clock_min_explained_alone: float = 0.9
    clock_min_lag_ratio: float = 2.0
    clock_min_structure: float = 0.25
    clock_min_motion: float = 25.0
    regulator_step: float = 4e-3
    regulator_substeps: int = 8
    regulator_max_remaining: float = 0.9
    regulator_max_noise: float = 1.3
    regulator_exact: float = 1e-3
    regulator_range_sigmas: float = 5.0
    regulator_range_share: float = 0.02
    regulator_min_delay: float = 1e-3
    beginning_block: float = 1.0
    beginning_min_misfit: float = 10.0
    beginning_max_motion: float = 3.0
    beginning_max_share: float = 0.15


DEFAULT = PreparationSettings()
