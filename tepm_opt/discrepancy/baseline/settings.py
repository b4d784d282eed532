"""Settings of the comparison with a baseline."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BaselineSettings:
    """Thresholds of the comparison with a baseline.

    Attributes:
        chance_sigmas: standard deviations by which the model's error may differ between two recordings, and by which parameters may be off
            what the baseline tells of them, by chance.
        max_noise_excess, min_excess_removed: the settings of the search of the same names, for what is left beyond chance already.
        min_main_share: share of the change that an effect must close alone to keep its probability beside others.
        unknown_law_odds: how many times as probable beforehand one law that is in no library is as one that is. Each further known cause
            is `one_cause_odds` times less probable.
        min_blocks: fewest independent blocks of time from which the model's error is estimated.
        windows: past over which inputs are averaged to tell one kind of motion from another, in times for which the model's error lasts.
        max_new_motion: share of one recording with motions that the other has nowhere, beyond which a change is not told from the model's
            error.
        min_input_spread: least standard deviation of an averaged input, as a share of its largest value, in the comparison of motions.
    """

    chance_sigmas: float = 3.0
    max_noise_excess: float = 0.005
    min_excess_removed: float = 0.01
    min_main_share: float = 0.75
    unknown_law_odds: float = 0.2
    min_blocks: int = 20
    windows: tuple[float, ...] = (0.0, 1.0, 4.0)
    max_new_motion: float = 0.25
    min_input_spread: float = 0.05


DEFAULT = BaselineSettings()
