"""How results show themselves: in a line that says first how they ended, and as tables in notebooks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.discrepancy.adapters.network import candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import leave_out
from tepm_opt.discrepancy.selection.fitting import Fits, Hypothesis
from tepm_opt.discrepancy.selection.forward_backward import Explanation
from tepm_opt.discrepancy.selection.screening import Score
from tepm_opt.discrepancy.state import Discovery
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem, identify
from tepm_opt.solvers.kinematics.ik import solve_ik
from tepm_opt.solvers.linear.gain import input_curve, solve_gain, workspace_map
from tepm_opt.solvers.linear.modal_model import modal_model
from tepm_opt.solvers.linear.modes import modes
from tepm_opt.solvers.linear.reduction import balanced_reduction
from tepm_opt.solvers.linear.state_space import linearise
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant, free_parameters
from tepm_opt.solvers.mechanics.predict import predict
from tepm_opt.solvers.mechanics.simulate import Directions, simulate
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.planning.family import FamilyFit, make_family
from tepm_opt.solvers.planning.plan import plan_move
from tests.discrepancy.small import NOISE, cut, dataset_of, measured, planned
from tests.discrepancy.test_report import LOCALISATION, VERDICT

REACHED, UNREACHED = [0.06, 0.0, 0.34], [0.05, 0.0, 0.65]
TIME = np.array([0.0, 0.1])


@dataclass(frozen=True)
class Subjects:
    """What results are made of."""

    model: CompiledModel
    estimate: ParameterEstimate

    @property
    def problem(self) -> Problem:
        return self.estimate.problem

    def rest(self) -> object:
        return solve_statics(self.model, np.zeros(12))

    def simulation(self) -> object:
        return simulate(self.model, SetPoints(TIME, np.zeros((2, 12)), np.zeros((2, 3))))

    def hypothesis(self) -> Hypothesis:
        effects = tuple(candidate("sensor_offset", f"s{k}") for k in range(1, 5))
        return Hypothesis(effects, self.estimate, leave_out(self.estimate, SearchSettings()))

    def explanation(self) -> Explanation:
        found = self.hypothesis()
        return Explanation(replace(found, effects=()), found, found, [found], [], {}, {})


@pytest.fixture(scope="module")
def subjects(kang: CompiledModel) -> Subjects:
    runs = [replace(cut(run, 2.0), file=f"{'long ' * 40}{run.file}") for run in measured(kang, planned()[:2])]
    return Subjects(kang, identify(Problem(NetworkPlant(kang), tuple(runs), free_parameters(kang), NOISE), 1))


SHOWN: dict[str, Callable[[Subjects], object]] = {
    "Equilibrium(solved": lambda s: s.rest(),
    "Equilibrium(unstable": lambda s: solve_statics(s.model, np.zeros(12), [0, 0, -3.0]),
    "Configuration(solved": lambda s: solve_ik(s.model, REACHED),
    "Configuration(out of reach": lambda s: solve_ik(s.model, UNREACHED),
    "Allocation(": lambda s: solve_ik(s.model, REACHED).allocation,
    "Gain(s4": lambda s: solve_gain(solve_statics(s.model, np.zeros(12))),
    "Curve(": lambda s: input_curve(s.model, "pressure", "11", count=3),
    "WorkspaceMap(": lambda s: workspace_map(s.model, [0.0], [0.3]),
    "Directions(": lambda s: Directions.from_names(s.model, list(s.model.values)[:6], ["pressure_11"]),
    "Simulation(solved": lambda s: s.simulation(),
    "Prediction(": lambda s: predict(s.model, s.problem.runs[0]),
    "Problem(": lambda s: s.problem,
    "Residual(": lambda s: s.estimate.residuals[0],
    "ParameterEstimate(solved": lambda s: replace(s.estimate, outcome=Outcome()),
    "ParameterEstimate(not converged": lambda s: replace(s.estimate, outcome=Outcome(Ending.NOT_CONVERGED)),
    "Linear(": lambda s: linearise(solve_statics(s.model, np.zeros(12))),
    "Linear(216 states, 6 inputs, 3 outputs": lambda s: linearise(solve_statics(s.model, np.zeros(12))).select("pressure", "s4"),
    "Reduced(balanced": lambda s: balanced_reduction(linearise(solve_statics(s.model, np.zeros(12))), 6, None, "pressure", "s4"),
    "Mode(": lambda s: modes(linearise(solve_statics(s.model, np.zeros(12))))[0],
    "ModalModel(": lambda s: modal_model(solve_statics(s.model, np.zeros(12))),
    "MotionPlan(out of reach": lambda s: plan_move(s.model, REACHED, UNREACHED),
    "Family(": lambda s: make_family(
        s.model,
        np.array([solve_ik(s.model, REACHED).equilibrium.lengths[0]]),
        solve_ik(s.model, REACHED).equilibrium,
        FamilyFit(degree=1, nodes=2, dynamics_degree=1, dynamics_nodes=2, validation_samples=1),
    ),
    "Score(": lambda s: Score(candidate("payload"), 0.5, {}),
    "Evidence(": lambda s: leave_out(s.estimate, SearchSettings()),
    "Hypothesis(": lambda s: s.hypothesis(),
    "Explanation(": lambda s: s.explanation(),
    "Fits(": lambda s: Fits(s.problem, SearchSettings()),
    "Localisation(": lambda s: LOCALISATION,
    "Named(": lambda s: VERDICT.effects[0],
    "Verdict(named": lambda s: VERDICT,
    "Discovery(named": lambda s: Discovery(
        VERDICT, dataset_of(s.model, s.problem.runs), NOISE, LOCALISATION, {}, s.explanation()
    ),
}  # fmt: skip


@pytest.mark.parametrize("begins", SHOWN)
def test_a_result_shows_itself_in_a_line(subjects: Subjects, begins: str) -> None:
    text = repr(SHOWN[begins](subjects))
    assert text.startswith(begins), text
    assert text.endswith(")")
    assert "\n" not in text
    assert len(text) < 120, text


def test_tables_for_notebooks(subjects: Subjects) -> None:
    gain = solve_gain(solve_statics(subjects.model, np.zeros(12)))._repr_html_()
    assert gain.count("<tr>") == 4
    parameters = subjects.estimate._repr_html_()
    assert parameters.count("<tr>") == 1 + len(subjects.estimate.values)
    assert all(f"<td>{free.name}</td>" in parameters for free in subjects.problem.free)
    verdict = VERDICT._repr_html_()
    assert "others &amp; nothing else" in verdict
    assert "<td>actuator_gain[13]</td><td>0.997</td><td>loss</td><td>0.1203</td>" in verdict
