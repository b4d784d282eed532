"""Decisions of the search for free-form laws."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SymbolicSettings:
    """Thresholds and grids of the search for free-form laws. Shares are of the structure left: squares beyond those of the noise.

    Attributes:
        noise_excess: excess of the squares over the noise, in parts of it, that still counts as noise, above 0; as
            `SearchSettings.max_noise_excess`.
        sample_spacing: time in s between the samples of the first-order pass, above 0. Forces are told apart by the
            sway they cause, which is slower than that.
        smoothness: strengths of the smoothness prior in parts of the data's information, one of which is chosen by left-out data.
        lag_times: time constants in s of smooth laws with a lag, a factor of four to five apart.
        play_widths: half-widths of smooth laws with a play, in parts of the visited range.
        min_promise: share that a smooth law must close, 0 … 1. It is only of first order, hence less than `min_closed`.
        place_margin: share by which another place may be worse to first order and still be tried, 0 … 1.
        places_tried: places whose formulas are sought, at least 1.
        formula_lag_times: time constants in s of formulas with a lag, 0.02 … 8 in 14 equal ratios.
        formula_play_widths: half-widths of formulas with a play, in parts of the visited range, 0.004 … 0.4 in 14 equal ratios.
        most_terms: terms of the longest formula, at least 1.
        most_paired: number of possible terms up to which all pairs are tried, for time.
        beam_width: sets of terms that grow at the same time, at least 1.
        material_share: share below which one more term is not worth its length, 0 … 1.
        term_cost: share that one more term costs where formulas of different places compete, 0 … 1.
        formulas_fitted: formulas that are fitted through the simulation, at least 1.
        fit_steps: most steps of such a fit.
        min_closed: share that a law must close in left-out data to be reported, 0 … 1.
        range_margin: part of the visited range by which a run may leave it without a warning, at least 0.
    """

    noise_excess: float = 0.05
    sample_spacing: float = 0.08
    smoothness: tuple[float, ...] = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
    lag_times: tuple[float, ...] = (0.05, 0.2, 0.8, 4.0)
    play_widths: tuple[float, ...] = (0.01, 0.03, 0.08, 0.2)
    min_promise: float = 0.05
    place_margin: float = 0.15
    places_tried: int = 3
    formula_lag_times: tuple[float, ...] = (0.02, 0.032, 0.05, 0.08, 0.126, 0.2, 0.318, 0.504, 0.799, 1.266, 2.007, 3.183, 5.046, 8.0)
    formula_play_widths: tuple[float, ...] = (
        0.004, 0.0057, 0.0081, 0.0116, 0.0165, 0.0235, 0.0335, 0.0478, 0.0681, 0.097, 0.1382, 0.197, 0.2807, 0.4,
    )  # fmt: skip
    most_terms: int = 4
    most_paired: int = 90
    beam_width: int = 5
    material_share: float = 0.02
    term_cost: float = 0.01
    formulas_fitted: int = 2
    fit_steps: int = 12
    min_closed: float = 0.25
    range_margin: float = 0.02


DEFAULT = SymbolicSettings()
