"""Settings of the check for set-up errors."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SetupSettings:
    """Thresholds of the check for set-up errors, set on 30 kinds of mistakes in runs of an independent simulator.

    Attributes:
        rows: samples of a run at which models and data are compared.
        slow_rows: of these, the slowest of so many stretches, for hypotheses that are screened by statics.
        sample_spacing: time in s between the samples of a network's motion, and its time step.
        first_rows: samples of each run of a plant that is simulated in full for every hypothesis.
        confirmed: most hypotheses that are simulated in full after the screening.
        lag, shift, turn: size of the nuisances besides the known parameters: a late clock in s, a shifted frame in m, a turned one in rad.
        max_nuisance: times its size that a nuisance may be: 2 is a frame turned by 6 deg.
        max_distance: of a mend's coefficient from 1; beside an effect of ordinary size it was 0.33 at most.
        max_distance_smaller: the same where a mend makes inputs smaller, as muscles and tendons do that lost some force.
        min_sigma: standard deviations by which the coefficient must be above 1/2, from which on a mend explains more than it spoils.
        min_removed: mean square over the noise's that a mend must remove.
        max_unexplained: share of the measured motion's square that may be left with the mend; beside effects it was 0.14 at most.
        max_left: share of the misfit's square that may be left with the mend: a coarse model's own error gives to some mend or other (0.89
            on a measured trunk); beside effects right mends left 0.38 at most, absolute pressures 0.67.
        max_left_by_clock: share of the misfit on another clock that a mend must leave, where such a clock explains as much as the mend.
        refitted, refit_steps: mends with which the known parameters of a quick plant are fitted, and steps of these fits, where no mend
            explains the runs with the guessed values.
        max_refit_left: share of the squares of the fit to the recorded runs that the fit to the mended ones may leave.
        worth: independent samples that the compared ones are worth, for the odds of mends: neighbours say nearly the same.
        min_listed: probability from which an alternative is told.
        foreign_ratio: mean square that the corrected model leaves in a run over that in every other one, from which the run is odd.
        min_runs: least number of runs of which one can be odd.
        max_errors: most set-up errors found one after the other.
    """

    rows: int = 60
    slow_rows: int = 10
    sample_spacing: float = 0.04
    first_rows: int = 2000
    confirmed: int = 5
    lag: float = 0.2
    shift: float = 0.005
    turn: float = 0.05
    max_nuisance: float = 2.0
    max_distance: float = 0.4
    max_distance_smaller: float = 0.05
    min_sigma: float = 2.5
    min_removed: float = 0.1
    max_unexplained: float = 0.3
    max_left: float = 0.7
    max_left_by_clock: float = 0.7
    refitted: int = 3
    refit_steps: int = 20
    max_refit_left: float = 0.3
    worth: float = 60.0
    min_listed: float = 0.1
    foreign_ratio: float = 5.0
    min_runs: int = 4
    max_errors: int = 3


DEFAULT = SetupSettings()
