"""What changed since an earlier recording: the model's error there is no news, its parameters come over with their posterior."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from tepm_opt.data.run import Run, RunSet
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.assessment.result import Verdict, VerdictStatus
from tepm_opt.discrepancy.baseline.baseline import Baseline
from tepm_opt.discrepancy.baseline.motion_range import MotionRange, share_unlike
from tepm_opt.discrepancy.laws.mechanism import MECHANISM
from tepm_opt.discrepancy.laws.signals import INPUT
from tepm_opt.discrepancy.pipeline import discover, learn_baseline
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.state import Question
from tepm_opt.errors import InputError
from tepm_opt.jobs.discrepancy import DiscrepancyOptions, run_discrepancy

STEP, NOISE, GRAVITY = 0.05, 1e-4, 9.81


def pendulum(payload: bool = True) -> CasadiPlant:
    """A hanging arm turned by a spring whose other end is commanded: linear in the model."""
    laws = [law for law in (*INPUT, *MECHANISM) if payload or law.name != "payload"]
    m = Equations("arm", time=0.4, laws=[law for law in laws if law.name in ("payload", "linear_damper", "input_gain", "input_offset")])
    angle, speed, command = m.state("angle"), m.state("speed"), m.input("command", size=0.5, unit="rad")
    stiffness, damping = m.parameter("stiffness", 3.0, "N m/rad", within=0.5), m.parameter("damping", 0.2, "N m s/rad", within=0.9)
    zero, mass = m.parameter("zero", 0.0, "rad", low=-0.1, high=0.1), 0.5 + m.mass("tip", size=0.2)
    lost = m.axis("joint", angle, speed, force=1.0, speed=2.0, position=0.3, unit="rad")
    moment = stiffness * (command + zero - angle) - damping * speed - mass * GRAVITY * 0.3 * angle + lost
    m.rate(angle, speed)
    m.rate(speed, moment / (mass * 0.3**2))
    m.output("angle", angle, "rad", size=0.3)
    return m.plant(substeps=2)


def recording(
    name: str, seed: int, mass: float = 0.0, friction: float = 0.0, seconds: float = 80.0, pace: float = 1.5, offset: float = 0.0,
    at_random: bool = False,
) -> RunSet:  # fmt: skip
    """Runs of an arm whose spring hardens and whose base sways, in three sines or at random, which no law of the model knows."""
    random, runs = np.random.default_rng(seed), []
    for k in range(4):
        time = np.arange(0.0, seconds / 4, STEP)
        command = offset + sum(0.2 * np.sin(pace * w * time + random.uniform(0, 6)) for w in (1.1, 1.7, 2.3, 3.4))
        sway = sum(0.02 * np.sin(w * time + random.uniform(0, 6)) for w in (0.9, 1.9, 2.9))
        if at_random:  # an Ornstein-Uhlenbeck process that forgets in half a second
            sway = lfilter([1.0], [1.0, -np.exp(-STEP / 0.5)], 0.008 * random.normal(size=len(time)))

        def rates(t: float, x: np.ndarray, at: np.ndarray = time, u: np.ndarray = command, base: np.ndarray = sway) -> list[float]:
            pull = np.interp(t, at, u) + np.interp(t, at, base) - x[0]
            moment = 3.2 * (pull + 0.05 * pull**3) - 0.25 * x[1] - (0.5 + mass) * GRAVITY * 0.3 * x[0] - friction * np.tanh(x[1] / 0.05)
            return [x[1], moment / ((0.5 + mass) * 0.3**2)]

        start = [3.2 * float(command[0]) / (3.2 + (0.5 + mass) * GRAVITY * 0.3), 0.0]
        angle = solve_ivp(rates, (0.0, time[-1]), start, t_eval=time, max_step=STEP, rtol=1e-6).y[0] + NOISE * random.normal(size=len(time))
        runs.append(Run(f"r{k}.csv", "fit", time, command[:, None], np.zeros((len(time), 3)), angle[:, None, None], start="measured"))
    return RunSet.from_runs(name, runs)


@pytest.fixture(scope="module")
def before() -> Baseline:
    return learned(recording("before", 1))


def learned(old: RunSet) -> Baseline:
    plant = pendulum()
    return learn_baseline(Question(old, plant, NOISE, SearchSettings.for_plant(plant)))


def changed(new: RunSet, baseline: Baseline, payload: bool = True) -> Verdict:
    return discover(new, pendulum(payload), NOISE, baseline=baseline).verdict


class TestWhatABaselineTells:
    def test_model_error_is_coloured_and_larger_than_the_noise(self, before: Baseline) -> None:
        error = before.error
        assert error.size[0, 0] > 30 * NOISE
        assert error.lasts > 3 * STEP
        assert error.weight == pytest.approx(error.lasts / STEP, rel=1e-6)
        assert error.blocks == pytest.approx(80.0 / error.lasts, rel=0.2)

    @pytest.mark.slow
    def test_posterior_is_joint_and_allows_for_the_colour(self, before: Baseline) -> None:
        """Recordings of the same arm scatter as one of them says, which white noise would put several times too low."""
        assert before.posterior.names == ("stiffness", "damping", "zero")
        others = [learned(recording("again", seed, at_random=True)) for seed in range(10, 18)]
        scatter = np.std([each.posterior.mean for each in others], axis=0, ddof=1)
        told = np.sqrt(np.mean([np.diag(each.posterior.covariance) for each in others], axis=0))
        assert np.all(scatter < 2 * told)
        assert np.all(scatter > told / 3)

    def test_too_short_a_recording_is_refused(self) -> None:
        with pytest.raises(
            InputError, match=r"short: the model's error lasts .* s, so that the data hold \d+ independent pieces; valid: a"
        ):
            learned(recording("short", 1, seconds=8.0))


class TestWhatChanged:
    @pytest.mark.slow
    def test_nothing(self, before: Baseline) -> None:
        for seed in (2, 3):
            verdict = changed(recording("after", seed), before)
            assert verdict.status is VerdictStatus.NO_DISCREPANCY, verdict
            assert verdict.sentences[0].startswith("Nothing changed since before beyond chance: ")
            assert verdict.baseline == "before"
            assert not verdict.effects

    @pytest.mark.slow
    def test_without_the_baseline_the_same_data_are_no_healthy_machine(self) -> None:
        assert discover(recording("after", 2), pendulum(), NOISE).verdict.status is not VerdictStatus.NO_DISCREPANCY

    @pytest.mark.sample(2)
    @pytest.mark.parametrize("mass", [0.5, 0.25])
    def test_a_payload_with_its_size(self, before: Baseline, mass: float) -> None:
        verdict = changed(recording("after", 5, mass=mass), before)
        assert verdict.status is VerdictStatus.NAMED, verdict
        (named,) = [effect for effect in verdict.effects if effect.probability >= 0.5]
        assert named.candidate.label == "payload[tip]"
        assert named.probability > 0.8
        found = named.parameters["mass"]
        assert abs(found.value - mass) < 2 * found.std
        assert found.std < 0.3 * mass
        assert verdict.sentences[0].startswith("Changed since before: payload[tip]")

    @pytest.mark.slow
    def test_something_that_no_law_explains(self, before: Baseline) -> None:
        verdict = changed(recording("after", 6, friction=0.8), before, payload=False)
        assert verdict.status in (VerdictStatus.UNEXPLAINED, VerdictStatus.PARTIAL), verdict
        assert all(effect.probability < 0.8 for effect in verdict.effects)

    def test_another_kind_of_motion_is_told_from_nothing(self, before: Baseline) -> None:
        """Slow motions about another place, where the baseline never stays: the hardening spring shows as never before."""
        new = recording("slow", 7, pace=0.1, offset=0.5)
        assert not before.moves_alike(new.fit)
        verdict = changed(new, before)
        assert not verdict.effects
        assert any("of before are nowhere in the other one" in note for note in verdict.notes)


class TestMotionRange:
    def test_of_the_same_kind_is_inside(self, before: Baseline) -> None:
        assert before.share_unlike(recording("after", 2).fit) < 0.1

    def test_an_input_that_never_moved_tells(self) -> None:
        time, zeros = np.arange(0, 10, STEP), np.zeros(200)
        run = Run("r", "fit", time, np.stack([np.sin(time), zeros], 1), np.zeros((200, 3)), np.zeros((200, 1, 1)))
        motions = MotionRange.from_runs([run], 0.5)
        moved = replace(run, inputs=np.stack([np.sin(time), zeros + 0.01], 1))
        assert motions.share_outside([run]) == 0.0
        assert motions.share_outside([moved]) == 1.0

    def test_slow_motions_alone_are_another_kind_than_slow_and_fast_ones(self) -> None:
        """None of them is outside, but most of the others are."""
        time = np.arange(0, 60, STEP)
        both = 0.5 * np.sin(0.5 * time) + 0.5 * np.sin(6.1 * time)
        slow = 0.5 * np.sin(0.5 * time)
        first, second = (Run("r", "fit", time, u[:, None], np.zeros((len(time), 3)), np.zeros((len(time), 1, 1))) for u in (both, slow))
        assert MotionRange.from_runs([first], 0.5).share_outside([second]) < 0.1
        assert share_unlike([first], [second], 0.5) > 0.25
        assert share_unlike([first], [first], 0.5) == 0.0


class TestCommand:
    @pytest.mark.slow
    def test_of_a_plant_file_writes_what_the_baseline_tells(self, tmp_path: Path) -> None:
        """The same from files: a plant of a data set, `--baseline`, `baseline.json`."""
        plant = tmp_path / "arm.py"
        plant.write_text("from tests.discrepancy.test_baseline import pendulum\n\nplant = pendulum()\n", encoding="utf-8")
        old, new = (write(recording(name, seed, mass), tmp_path / name) for name, seed, mass in (("old", 1, 0.0), ("new", 5, 0.25)))
        found = run_discrepancy(new, tmp_path / "out", plant=plant, options=DiscrepancyOptions(baseline=old))
        assert [effect.candidate.label for effect in found.verdict.effects if effect.probability > 0.8] == ["payload[tip]"]
        content = json.loads((tmp_path / "out" / "verdict.json").read_text(encoding="utf-8"))
        told = json.loads((tmp_path / "out" / "baseline.json").read_text(encoding="utf-8"))
        assert content["baseline"] == told["name"] == "old"
        assert [each["name"] for each in told["parameters"]] == ["stiffness", "damping", "zero"]
        np.testing.assert_allclose(np.sqrt(np.diag(told["covariance"])), [each["std"] for each in told["parameters"]])
        assert "baseline" not in found.verdict.command or str(old) in found.verdict.command
        file = tmp_path / "out" / "baseline.json"
        again = run_discrepancy(new, tmp_path / "again", plant=plant, options=DiscrepancyOptions(baseline=file)).verdict
        assert [(e.candidate.label, e.probability) for e in again.effects] == [
            (e.candidate.label, e.probability) for e in found.verdict.effects
        ]
        assert json.loads((tmp_path / "again" / "baseline.json").read_text()) == told
        (old / "r0.csv").write_text((old / "r1.csv").read_text())
        with pytest.raises(
            InputError, match=r"baseline\.json: the data, the model or tepm-opt are not those of then; valid: --baseline .*old"
        ):
            run_discrepancy(new, tmp_path / "third", plant=plant, options=DiscrepancyOptions(baseline=file))
        (tmp_path / "out" / "deeper").mkdir()
        moved = file.rename(tmp_path / "out" / "deeper" / "baseline.json")
        with pytest.raises(InputError, match=r"baseline\.json: its data set .*old is not there; valid: the file where it was written"):
            run_discrepancy(new, tmp_path / "third", plant=plant, options=DiscrepancyOptions(baseline=moved))
        file.write_text("{}")
        with pytest.raises(InputError, match=r"baseline\.json: names no data; valid: "):
            run_discrepancy(new, tmp_path / "third", plant=plant, options=DiscrepancyOptions(baseline=file))


def write(recorded: RunSet, folder: Path) -> Path:
    """A data set in files."""
    folder.mkdir()
    lines = [f'name = "{recorded.name}"', 'start = "measured"', f"[noise]\nangle = {NOISE}"]
    for run in recorded.runs:
        table = np.column_stack([run.time, run.inputs, run.points[:, 0]])
        np.savetxt(folder / run.file, table, delimiter=",", header="time_s,command,angle", comments="", fmt="%.7g")
        lines.append(f'[[runs]]\nfile = "{run.file}"\nrole = "fit"')
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder
