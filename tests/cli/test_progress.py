"""Bars of long work: one a stage, side by side where stages run side by side, and nothing where nobody looks."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from tepm_opt.cli import progress


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Console:
    """The error stream as a terminal of 80 columns whose text can be read."""
    console = Console(file=io.StringIO(), force_terminal=True, width=80, color_system=None, legacy_windows=False)
    monkeypatch.setattr(progress, "stderr", console)
    return console


def descriptions(bars: progress.Bars) -> list[str]:
    """Stages that are shown."""
    return [task.description for task in bars._display.tasks]


def test_a_stage_that_is_over_gives_way(terminal: Console) -> None:
    with progress.shown(quiet=False) as bars:
        bars("reading", 0, 0)
        bars("points", 0, 4)
        bars("points", 4, 4)
        bars("simulation", 0.5, 2.0)
        assert descriptions(bars) == ["simulation"]
        bars._display.refresh()
    shown = terminal.file.getvalue()  # type: ignore[attr-defined]
    assert "simulation" in shown
    assert "0.5 of 2.0" in shown


def test_stages_that_run_beside_each_other_are_all_shown(terminal: Console) -> None:
    with progress.shown(quiet=False) as bars:
        bars("mpc", 1, 4)
        bars("mode 1", 1, 4)
        bars("mpc", 2, 4)
        assert descriptions(bars) == ["mpc", "mode 1"]


def test_one_without_news_gives_way(terminal: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "FORGOTTEN", -1.0)
    with progress.shown(quiet=False) as bars:
        bars("approach", 2.9, 3.0)
        bars("run", 0, 8)
        assert descriptions(bars) == ["run"]


def test_nothing_is_shown_to_programs(terminal: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    with progress.shown(quiet=True) as bars:
        bars("points", 1, 4)
    assert terminal.file.getvalue() == ""  # type: ignore[attr-defined]
    file = io.StringIO()
    monkeypatch.setattr(progress, "stderr", Console(file=file, force_terminal=False))
    with progress.shown(quiet=False) as bars:
        bars("points", 1, 4)
    assert file.getvalue() == ""


def test_asking_a_person(terminal: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with progress.shown(quiet=False) as bars:
        bars.ask("put the load on [now]")
    assert "put the load on [now]" in terminal.file.getvalue()  # type: ignore[attr-defined]
