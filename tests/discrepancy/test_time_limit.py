"""A search that ends after a time says what it left untried, and goes on from there when it is asked again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.time_limit import TimeLimit, TimeLimitError
from tepm_opt.errors import InputError
from tepm_opt.jobs.discrepancy import FITS, DiscrepancyOptions, run_discrepancy
from tests.discrepancy.test_quick_plants import NOISE, runs
from tests.tank import write_plant, write_tank


@pytest.fixture
def late(tmp_path: Path) -> Path:
    """Levels of a tank that follows its inflow 0.2 s late; `tank.py` beside them knows nothing of that."""
    random, measured = np.random.default_rng(1), []
    for run in runs(4, leak=2.0):
        still = run.inputs[0, 0] / 2.0 + NOISE * random.normal(size=(10, 1, 1))
        measured.append(replace(run, points=np.concatenate([still, run.points[:-10]])))
    write_plant(tmp_path / "tank.py", within=0.05)
    return write_tank(tmp_path / "late", measured, NOISE)


@pytest.mark.slow
def test_what_is_named_in_time_is_a_part_at_best(late: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time is up after a few iterations; asked again without a limit, the search takes over what it had."""
    allowed = iter([False] * 8)
    monkeypatch.setattr(TimeLimit, "is_over", property(lambda self: self.minutes < 1e3 and next(allowed, True)))
    out, plant = tmp_path / "out", tmp_path / "tank.py"
    early = run_discrepancy(late, out, plant=plant, options=DiscrepancyOptions(minutes=1.0)).verdict
    assert early.status in (VerdictStatus.PARTIAL, VerdictStatus.UNEXPLAINED)
    assert any(note.startswith("Time: the search ended after 1 minutes") for note in early.notes)
    assert early.command.startswith("tepm discrepancy")
    assert "--minutes" not in early.command
    assert (out / FITS).is_file()
    whole = run_discrepancy(late, out, plant=plant).verdict
    assert whole.status is VerdictStatus.NAMED
    assert not any(note.startswith("Time:") for note in whole.notes)
    assert not (out / FITS).exists()


def test_the_remark_names_what_was_left() -> None:
    limit = TimeLimit(0.0)
    for name in ("payload", "creep"):
        with pytest.raises(TimeLimitError):
            limit.check((Candidate(name, None, (), "", {}),))
    assert "left 2 sets of effects unfitted, with payload, creep" in limit.remark


def test_no_limit_is_never_over() -> None:
    limit = TimeLimit()
    limit.check(())
    assert not limit.untried


@pytest.mark.parametrize("minutes", [0.0, -3.0, float("nan")])
def test_no_time_at_all_is_refused(tmp_path: Path, minutes: float) -> None:
    with pytest.raises(InputError, match=r"--minutes: .* valid: above 0, such as 10"):
        run_discrepancy(tmp_path, tmp_path / "out", options=DiscrepancyOptions(minutes=minutes))


@pytest.mark.slow
@pytest.mark.parametrize("checks", [16, 30, 42])
def test_a_stand_in_is_not_certain_while_its_rival_is_untried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, checks: int) -> None:
    """A gain before the tank and one behind it are the same to the data: whichever the search fits first has one half at most."""
    random, measured = np.random.default_rng(1), []
    for run in runs(4, leak=2.0):
        still = run.inputs[0, 0] / 2.0 + NOISE * random.normal(size=(10, 1, 1))
        measured.append(replace(run, points=np.minimum(1.3 * np.concatenate([still, run.points[:-10]]), 0.75)))
    folder, plant = write_tank(tmp_path / "data", measured, NOISE), write_plant(tmp_path / "tank.py", within=0.05)
    allowed = iter([False] * checks)
    monkeypatch.setattr(TimeLimit, "is_over", property(lambda self: next(allowed, True)))
    verdict = run_discrepancy(folder, tmp_path / "out", plant=plant, options=DiscrepancyOptions(minutes=1.0)).verdict
    assert all(named.probability <= 0.5 for named in verdict.effects if named.candidate.name.endswith("_gain"))


def test_rivals_are_untried_sets_without_an_effect() -> None:
    payload, creep = Candidate("payload"), Candidate("creep")
    limit = TimeLimit(untried={(payload,): None, (creep,): None, (creep, payload): None})
    assert (limit.rivals(payload), limit.rivals(Candidate("slack"))) == (1, 3)


def test_work_left_out_is_told() -> None:
    limit = TimeLimit(0.0)
    assert not limit.was_short
    assert not limit.allows("screening 7 effects")
    assert limit.was_short
    assert "after 0 minutes and left undone: screening 7 effects." in limit.remark


@pytest.mark.slow
def test_without_any_time_nothing_is_decided(late: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The known parameters are fitted, nothing is screened, and the answer does not say that no known effect explains the rest."""
    monkeypatch.setattr(TimeLimit, "is_over", True)
    verdict = run_discrepancy(late, tmp_path / "out", plant=tmp_path / "tank.py", options=DiscrepancyOptions(minutes=1.0)).verdict
    assert verdict.status is VerdictStatus.UNEXPLAINED
    assert verdict.paragraph.startswith("Undecided: the search ended before")
    (note,) = (note for note in verdict.notes if note.startswith("Time:"))
    assert "undone: screening" in note
