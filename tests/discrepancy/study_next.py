"""How often a run of 30 s that `tepm data next` proposes separates what data leave indistinguishable, beside a random run of that length.

`python -m tests.discrepancy.study_next [--cases 20] [--seed 1] [--seconds 30]` hides effects of the library in badly excited sessions (one
or two drawn runs of 4 to 8 s), at sizes that are found but do not tell the effect from its closest rival; keeps those where the weights of
the two hypotheses (fits and evidence as in the workflow, without its search) leave the best below 0.8; proposes, simulates and adds a run;
prints a line each. "large" are sizes that the workflow would name, "small" those below.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.data.datasets import in_session
from tepm_opt.data.run import Run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.discrepancy.adapters.network import SearchableNetwork
from tepm_opt.discrepancy.assessment.settings import DEFAULT
from tepm_opt.discrepancy.experiments.information import Move, Separability, information
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import weights
from tepm_opt.discrepancy.selection.fitting import Fits, Hypothesis
from tepm_opt.errors import InputError
from tepm_opt.jobs.next_run import Proposal, Rig, any_run, best_run
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.recording.plan import PlannedRun
from tepm_opt.recording.reach import reach_of
from tepm_opt.solvers.identification.identify import Problem
from tepm_opt.solvers.mechanics.plant import PredictionError
from tepm_opt.solvers.mechanics.predict import LONGEST_STEP
from tepm_opt.solvers.mechanics.simulate import SimulationError, simulate
from tepm_opt.studies.blind.excitation import draw_runs

NOISE, RATE = 3e-4, 50.0
STEP = 5e-3  # s, shorter than any fit's
HIDDEN = (0.25, 0.6)  # of the size at which the rival would be told apart
SHOWS = 2.0  # times the size that is found


@dataclass(frozen=True, eq=False)
class Case:
    """A session in which an effect is hidden that cannot be told from its rival.

    Attributes:
        network: with all effects at their null values.
        truth: of the machine, by full name.
        pair: the hidden effect and its rival.
        runs: made of it.
        fitted: both hypotheses.
        seed: of the noise.
    """

    network: SearchableNetwork
    truth: dict[str, float]
    pair: tuple[Candidate, Candidate]
    runs: tuple[Run, ...]
    fitted: tuple[Hypothesis, Hypothesis]
    seed: int

    def measured(self, planned: PlannedRun) -> Run:
        """What the machine measures in a further run."""
        last = self.runs[-1]
        run = replace(planned.sample_at(RATE, self.runs[0].points.shape[1]), began=last.began + last.duration + 5.0)
        return made(self.network, self.truth, run, np.random.default_rng([self.seed, 9]))

    def odds(self, planned: PlannedRun) -> float:
        """Probability of the hidden effect once a run has been added."""
        both = fitted(self.network, (*self.runs, self.measured(planned)), self.pair, [h.estimate.named for h in self.fitted])
        return float("nan") if both is None else float(weights([h.evidence for h in both], 0)[0])


def made(network: SearchableNetwork, values: dict[str, float], run: Run, random: np.random.Generator) -> Run:
    """A run as a machine that is the model with these values measures it."""
    model = network.with_values(values).model
    points = simulate(model, SetPoints(run.time, run.inputs, run.tip_force), step=STEP, began=run.began).complete().points
    return replace(run, points=points + NOISE * random.normal(size=points.shape))


def fitted(
    network: SearchableNetwork, runs: Sequence[Run], pair: Sequence[Candidate], starts: Sequence[dict[str, float]] = ()
) -> tuple[Hypothesis, Hypothesis] | None:
    """Both hypotheses fitted to runs; None where the model cannot do them."""
    free = network.free(network.known)
    problem = Problem(network, tuple(runs), free, NOISE, step=LONGEST_STEP, derivatives_apart=network.derivatives_apart)
    fits = Fits(problem, SearchSettings.for_plant(network))
    if not starts:
        base = fits.fit((), {})
        if base is None:
            return None
        linear = fits.linear(base, list(pair))
        starts = [{**base.estimate.named, **(linear.gain((c,))[1] if c in linear.able else c.probes[0])} for c in pair]
    one, other = (fits.fit((c,), dict(start)) for c, start in zip(pair, starts, strict=True))
    return None if one is None or other is None else (one, other)


def cases(network: SearchableNetwork, seed: int) -> Iterator[tuple[Case | None, str]]:
    """Cases, one effect of the library after the other; None, and why, where a draw is none."""
    random, number = np.random.default_rng([seed, 0]), 0
    channels = channels_of(network.known_model.robot)
    names = sorted({c.name for c in network.candidates})
    while True:
        for name in random.permutation(names):
            number += 1
            designs = draw_runs(random, 4.0, 8.0, fit=int(random.integers(1, 3)), judges=0)
            sampled = [PlannedRun(d.file, "fit", d.setpoints).sample_at(RATE, len(channels.points)) for d in designs]
            session = in_session(sampled, {})
            try:
                told = information(network, session, NOISE, network.candidates)
            except PredictionError as error:
                yield None, str(error)
                continue
            shown = [told.separability(move, 0.15) for move in told.moves if move.candidate.name == name]
            alike = [s for s in shown if s.rival is not None and np.isfinite(s.apart) and SHOWS * s.found < HIDDEN[1] * s.apart]
            if not alike:
                yield None, f"{name}: told from its rivals wherever it shows"
                continue
            one = alike[int(random.integers(len(alike)))]
            yield _case(network, one, session, random, int(seed * 1000 + number))


def _case(
    network: SearchableNetwork, one: Separability, session: Sequence[Run], random: np.random.Generator, seed: int
) -> tuple[Case | None, str]:
    assert one.rival is not None
    move: Move = one.move
    size = random.uniform(max(HIDDEN[0] * one.apart, SHOWS * one.found), HIDDEN[1] * one.apart)
    nominal = network.known_model.values
    widths = network.known_model.robot.priors
    truth = {name: nominal[name] * (1 + 0.7 * random.uniform(-width, width)) for name, width in sorted(widths.items())}
    truth |= {move.candidate.happens: 0.5 * (session[-1].began + session[-1].duration)} if move.candidate.happens else {}
    truth |= move.values_at(size)
    pair = (move.candidate, one.rival)
    label = f"{pair[0].label} / {pair[1].label} ({'large' if size >= one.material else 'small'}, {len(session)} runs)"
    try:
        runs = tuple(made(network, truth, run, random) for run in session)
        both = fitted(network, runs, pair)
    except (SimulationError, PredictionError, InputError) as error:
        return None, f"{label}: {error}"
    if both is None:
        return None, f"{label}: the model cannot do the runs"
    share = float(weights([h.evidence for h in both], 0)[0])
    if max(share, 1 - share) >= DEFAULT.min_named:
        return None, f"{label}: told already ({share:.2f})"
    return Case(network, truth, pair, runs, both, seed), f"{label}: {share:.2f}"


def word(share: float) -> str:
    """What became of a pair: the hidden effect, its rival, or neither is clear."""
    return "right" if share >= DEFAULT.min_named else "wrong" if share <= 1 - DEFAULT.min_named else "open"


def main() -> None:
    """Print a line for every case, and how many were resolved."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=30.0)
    options = parser.parse_args()
    model = Model.from_robot("kang2017")
    network = SearchableNetwork.from_model(model, channels_of(model.robot))
    _ = network.model.stepper
    rig = Rig(model, reach_of(compile_model(model)), RATE, NOISE, options.seconds)
    words: dict[str, list[str]] = {"next": [], "random": []}
    for case, why in cases(network, options.seed):
        if case is None:
            print(f"  no case: {why}", flush=True)
            continue
        began, estimates = time.monotonic(), [h.estimate for h in case.fitted]
        line = [why]
        proposals: dict[str, Proposal | None] = {
            "next": best_run(rig, estimates, case.seed),
            "random": any_run(rig, estimates, case.seed),
        }
        for kind, proposal in proposals.items():
            share = float("nan") if proposal is None else case.odds(proposal.planned)
            words[kind].append(word(share))
            sigmas = float("nan") if proposal is None else proposal.sigmas
            line.append(f"{kind} {sigmas:.1f} sigmas -> {share:.3f} {words[kind][-1]}")
        print(f"{len(words['next']):2d} {'; '.join(line)}; {time.monotonic() - began:.0f} s", flush=True)
        if len(words["next"]) == options.cases:
            break
    for kind, found in words.items():
        print(f"{kind}: {', '.join(f'{found.count(each)} {each}' for each in ('right', 'wrong', 'open'))} of {len(found)}")


if __name__ == "__main__":
    main()
