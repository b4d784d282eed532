"""Settings of the search for missing effects: thresholds, limits and the stages that a plant's cost allows."""

from __future__ import annotations

from dataclasses import dataclass

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.solvers.mechanics.plant import Plant


@dataclass(frozen=True)
class SearchSettings:
    """Thresholds and limits of the search, grouped by its stages.

    Squares are means over the measured coordinates. The excess is their part beyond the noise's, over the noise's (1: as much structure as
    noise). A gain is the share of the excess that a change of the model removes to first order. Shares and probabilities are 0 … 1.

    Attributes:
        max_noise_excess: excess that counts as noise: 0.05 is 22 % of the noise's standard deviation.
        chance_excess: excess that counts as chance, because the noise is a model's error on other data (`baseline`).
        chance_sigmas: standard deviations by which parameters may be off what other data tell of them by chance.
        min_size_sigma: standard deviations by which an effect's size must differ from the size at which it vanishes to be named.
        min_excess_removed: excess that an effect must remove alone to be named: 0.15 is 39 % of the noise's standard deviation. One of two
            that leave only noise must remove `max_noise_excess`.
        min_probability: probability by which one more effect must beat going without it to be tried along.
        even_odds_ratio: how many times the excess left an effect alone must remove for even odds that it is a cause, not a stand-in.
        even_odds_exact: the same where the forms of all effects that act are known exactly.
        even_odds_noise: the same where no more is left than counts as noise.
        max_effects: most effects at once, in searches that add one at a time.
        max_unexplained_ratio: share of the motion's standard deviation that may stay unexplained; beyond it nothing is named.
        estimate_beginnings: before the search: initial states of runs, and how long residuals remember, are estimated from a first fit.
        drop_beginnings: after the search: one that explains nothing is repeated without the beginnings of runs that stand out.
        check_constancy: after the search: effects are sized in parts of the data.
        final_step: after the search: time step in s of the final fit; what a longer step damps shows in a fitted damping.

        screen_by_fits: screening: candidates that are not smooth are screened by a few fit steps from every probe, not by one simulation.
            Further probes of smooth candidates are then left out.
        wide_above: screening: parameters, but for refinements, above which an effect counts as several at once ("wide"), as one whose
            parameters scatter does with any number.
        probe_run_stride: screening by fits: one run in so many is used.
        probe_steps, best_probe_steps: screening by fits: Gauss-Newton steps from every probe, and from the best of each candidate.
        min_start_gain: screening: share of the best probe's gain from which another probe is a second place to fit from.
        min_gain_ratio: screening: share of the best candidate's gain below which others are not fitted.
        plain_form_ratio: screening: share of a form's gain from which a form of the same family with fewer parameters replaces it.
        max_derivative_bytes: screening and fitting: memory in B for all derivatives together. Longer data are thinned to first order,
            and their fits run one after the other.

        fits_first_round, fits_later_rounds: fitting: most candidates fitted in the first round and in each later one.
        starts: fitting: most probes from which an effect is fitted.
        max_iterations: fitting: most Gauss-Newton steps of a fit.
        tolerance: fitting: share of the structure left below which a fit takes no further step.
        resume_fits: fitting: a fit that the answer rests on takes `max_iterations` more steps if it has not converged.
        adapt_fit_count: fitting: rivals far behind a fit that leaves only noise are skipped; a first round without one goes on once.
        far_rival_ratio, far_rival_margin: fitting: a rival is far behind if it promises to leave more than so many times what the fit
            promised, plus the margin; the margin is what first order may miss.
        early_end_ratio: fitting: how many times a rival's squares a fit must be sure to leave to be ended early.
        min_refinement_sigma: fitting: standard deviations from which a refinement counts as one more parameter.
        run_choice_parameters: fitting: parameters that a choice of runs is worth: the first and the last of them.

        refit_folds: cross-validation: every fold is refitted by simulation, not by one linear step. With linear steps, rivals whose outputs
            coincide are also compared on the data fitted to.
        run_parts: cross-validation: parts of a run, each of them a fold, where fewer than three runs leave none to spare.
        alone_share: cross-validation: share of the information on a parameter from which one run tells it alone and is cut into parts.
        fold_count: cross-validation by refits: folds.
        fold_parts: cross-validation by refits: parts of short data in each fold, so that every fold has of everything.
        refit_steps: cross-validation by refits: Gauss-Newton steps.

        beam: forward selection: sets of effects that are followed at the same time.
        beam_excess_ratio: forward selection: how many times the best set's excess another set may leave to be followed.
        min_share_closed: forward selection: share of the held-out excess that one more effect must remove.
        linear_moves: forward selection: sets are proposed to first order: several effects at once, exchanges, effects of some runs, pairs
            as rivals. Off, only single effects and, where none helps, pairs are tried: non-smooth candidates have no first order.
        repeat_forward: forward selection: continues after the backward elimination until neither changes anything.
        fits_per_move: forward selection: sets fitted of each kind of move.
        pair_candidates: forward selection: candidates, the best alone, that are tried in pairs.
        min_pair_share: forward selection: share of what the best single effect leaves that a pair, or an effect of some runs, must close.
        min_wide_share: forward selection: share of what the best pair leaves that a wide effect must close.
        run_choice_slack: forward selection: squares that a choice of more runs may leave beyond a choice of fewer; chance exceeds 6 once in
            fifty.
        least_share: backward elimination: how many times the excess left an effect must remove alone to stay.
        sure_share: backward elimination: how many times the excess left the removal of an effect must be for it to stay surely: fits
            without it then end early, while others are dropped.
        form_error_ratio: backward elimination: share of what the other effects remove that errors of their forms may leave: 5 % in size.
        min_mend_share: backward elimination: share of an effect's removal from which the excess left lets it be a form error of others.

        many_effects: matching pursuit: effects above which elimination and rivals are judged to first order.
        min_pursued: matching pursuit: effects that first order must ask for at once.
        min_pursued_share: matching pursuit: share of the excess left that each further effect must promise to remove.
        max_share_left: matching pursuit: share of the excess that many effects may leave to be accepted: else something else acts.
        max_cost_ratio: matching pursuit: share of the squares that first order's values may leave in a simulation, for it to hold.
        max_pursued, max_pursued_at_once: matching pursuit: most effects in all, and most new ones at once.
        several_effects: effects above which each is the likelier the less they leave together.
        min_odds_factor: matching pursuit: least factor on `even_odds_ratio` where many effects leave next to nothing.
        min_listed_probability: matching pursuit: probability from which an effect is listed.
        max_unsure_share: matching pursuit: share of what many effects remove that unsure or dropped ones may remove.
        rival_excess_ratio: matching pursuit: how many times the excess left a rival may promise to leave, to be fitted.

        one_cause_odds: alternatives: how many times as probable one cause is as two in its place that fit alike.
        all_runs_odds: alternatives: how many times as probable a cause in all runs is as one in some runs that fits alike.
        min_coincidence: alternatives: cosine from which the outputs of two effects are called the same.
        astray_ratio: alternatives: how many times the promised excess an earlier fit must leave to be repeated from the best fit.
        close_rival_ratio: alternatives: how many times the best excess a rival may leave to be fitted again from the best fit.
        max_repeated_fits: alternatives: most fits repeated so, for each of both reasons.
        min_rich_parameters: alternatives: parameters from which an effect of the body may do what two others do together.
        rich_pair_candidates: alternatives: candidates, the best alone, that are tried in pairs in the place of such an effect.
        max_wide_pair_share: alternatives: share of the excess without a wide effect that a pair in its place may promise to leave.
        max_parts_loss: alternatives: share of what a wide effect removes that single parts in its place may leave besides.
        max_pair_excess: alternatives: how many times the excess left a pair in an effect's place may promise to add.
        min_pair_weight: alternatives: probability from which a pair is compared with either of the two beside the effect that it replaces.
        min_centred_chance: alternatives: chance of its mean from which scatter counts as about zero; the odds that it may be about another.
    """

    max_noise_excess: float = 0.05
    chance_excess: float = 0.0
    chance_sigmas: float = 3.0
    min_size_sigma: float = 2.0
    min_excess_removed: float = 0.15
    min_probability: float = 0.95
    even_odds_ratio: float = 3.0
    even_odds_exact: float = 200.0
    even_odds_noise: float = 1.0
    max_effects: int = 6
    max_unexplained_ratio: float = 0.1
    estimate_beginnings: bool = False
    drop_beginnings: bool = False
    check_constancy: bool = True
    final_step: float = 0.005

    screen_by_fits: bool = False
    wide_above: int = 6
    probe_run_stride: int = 4
    probe_steps: int = 3
    best_probe_steps: int = 8
    min_start_gain: float = 0.5
    min_gain_ratio: float = 0.25
    plain_form_ratio: float = 0.9
    max_derivative_bytes: int = 120_000_000

    fits_first_round: int = 5
    fits_later_rounds: int = 3
    starts: int = 1
    max_iterations: int = 7
    tolerance: float = 5e-3
    resume_fits: bool = True
    adapt_fit_count: bool = True
    far_rival_ratio: float = 5.0
    far_rival_margin: float = 0.05
    early_end_ratio: float = 2.0
    min_refinement_sigma: float = 3.0
    run_choice_parameters: int = 2

    refit_folds: bool = False
    run_parts: int = 4
    alone_share: float = 0.8
    fold_count: int = 6
    fold_parts: int = 4
    refit_steps: int = 3

    beam: int = 1
    beam_excess_ratio: float = 1.5
    min_share_closed: float = 0.2
    linear_moves: bool = True
    repeat_forward: bool = True
    fits_per_move: int = 2
    pair_candidates: int = 10
    min_pair_share: float = 0.2
    min_wide_share: float = 0.5
    run_choice_slack: float = 6.0
    least_share: float = 1.0
    sure_share: float = 10.0
    form_error_ratio: float = 0.0025
    min_mend_share: float = 0.2

    many_effects: int = 4
    min_pursued: int = 3
    min_pursued_share: float = 0.1
    max_share_left: float = 0.05
    max_cost_ratio: float = 0.5
    max_pursued: int = 14
    max_pursued_at_once: int = 5
    several_effects: int = 2
    min_odds_factor: float = 1 / 6
    min_listed_probability: float = 0.3
    max_unsure_share: float = 0.1
    rival_excess_ratio: float = 1.3

    one_cause_odds: float = 20.0
    all_runs_odds: float = 3.0
    min_coincidence: float = 0.98
    astray_ratio: float = 3.0
    close_rival_ratio: float = 2.0
    max_repeated_fits: int = 2
    min_rich_parameters: int = 3
    rich_pair_candidates: int = 3
    max_wide_pair_share: float = 0.1
    max_parts_loss: float = 0.02
    max_pair_excess: float = 0.5
    min_pair_weight: float = 0.05
    min_centred_chance: float = 0.002

    @staticmethod
    def for_plant(plant: Plant) -> SearchSettings:
        """The usual settings; a plant that is quick to simulate bears a wider search with more steps and refits.

        Its forms are said to be exact by whoever wrote its equations.
        """
        if not plant.quick:
            return SearchSettings()
        return SearchSettings(
            even_odds_exact=10.0,
            max_effects=3,
            max_unexplained_ratio=0.2,
            estimate_beginnings=True,
            drop_beginnings=True,
            check_constancy=False,
            final_step=0.01,
            screen_by_fits=True,
            starts=2,
            max_iterations=30,
            tolerance=1e-4,
            resume_fits=False,
            adapt_fit_count=False,
            refit_folds=True,
            beam=2,
            min_share_closed=0.3,
            linear_moves=False,
            repeat_forward=False,
        )

    def is_wide(self, candidate: Candidate) -> bool:
        """Whether an effect counts as several at once: it is tried only where a pair does not do as well."""
        return candidate.scatters or len(set(candidate.parameters) - set(candidate.shapes)) > self.wide_above
