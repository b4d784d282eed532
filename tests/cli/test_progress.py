"""Progress of long work: a bar a stage on a terminal, side by side where stages run side by side; now and then a line elsewhere."""

from __future__ import annotations

import io
import time

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
    with progress.show_progress(quiet=False) as bars:
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
    with progress.show_progress(quiet=False) as bars:
        bars("mpc", 1, 4)
        bars("mode 1", 1, 4)
        bars("mpc", 2, 4)
        assert descriptions(bars) == ["mpc", "mode 1"]


def test_one_without_news_gives_way(terminal: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "FORGOTTEN", -1.0)
    with progress.show_progress(quiet=False) as bars:
        bars("approach", 2.9, 3.0)
        bars("run", 0, 8)
        assert descriptions(bars) == ["run"]


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """The error stream as a file."""
    file = io.StringIO()
    monkeypatch.setattr(progress, "stderr", Console(file=file, force_terminal=False))
    return file


def test_nothing_is_shown_to_programs(terminal: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "EVERY", 0.0)
    with progress.show_progress(quiet=True) as bars:
        bars("points", 1, 4)
    assert terminal.file.getvalue() == ""  # type: ignore[attr-defined]


def test_what_is_short_says_nothing_without_a_terminal(log: io.StringIO) -> None:
    with progress.show_progress(quiet=False) as bars:
        bars("points", 1, 4)
    assert log.getvalue() == ""


def test_lines_without_a_terminal(log: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    """How much of how much, and the time left at the pace so far, without what was done before; stages that are over are not told."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with progress.show_progress(quiet=False) as bars:
        bars.tell()
        bars("compiling", 0, 0)
        bars.tell()
        bars("trials", 40, 160)
        now[0] += 30
        bars("trials", 50, 160)
        bars.tell()
        now[0] += 1
        bars("mode 1", 0, 4)
        bars.tell()
        now[0] += 3600
        bars("trials", 51, 160)
        bars.tell()
        bars("trials", 160, 160)
        bars("mode 1", 2, 4)
        bars("drawing", 0, 0)
        bars.tell()
    assert [line.split(" s  ", 1)[1] for line in log.getvalue().splitlines()] == [
        "working",
        "compiling",
        "trials: 50 of 160, about 6 min left",
        "trials: 50 of 160, about 6 min left; mode 1: 0 of 4",
        "trials: 51 of 160, about 10.0 h left; mode 1: 0 of 4",
        "mode 1: 2 of 4, about 1.0 h left; drawing",
    ]
    assert log.getvalue().splitlines()[2].lstrip().startswith("30.0 s  ")


def test_a_stage_is_announced_once(log: io.StringIO) -> None:
    """Also where stages that run beside each other are heard of in turn."""
    with progress.show_progress(quiet=False, told=True) as bars:
        for done in range(3):
            bars("fitting creep", done, 7)
            bars("fitting payload", done, 7)
    assert [line.split(" s  ", 1)[1] for line in log.getvalue().splitlines()] == ["fitting creep", "fitting payload"]


def test_lines_come_by_themselves(log: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work that says nothing for long is told of all the same; when it is over, so are the lines."""
    monkeypatch.setattr(progress, "EVERY", 0.001)
    with progress.show_progress(quiet=False) as bars:
        bars("nonlinear program [1]", 0, 0)
        until = time.monotonic() + 20
        while "nonlinear program [1]" not in log.getvalue() and time.monotonic() < until:
            time.sleep(0.001)
    said = log.getvalue()
    assert "nonlinear program [1]" in said
    time.sleep(0.01)
    assert log.getvalue() == said


def test_asking_a_person(terminal: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with progress.show_progress(quiet=False) as bars:
        bars.ask("put the load on [now]")
    assert "put the load on [now]" in terminal.file.getvalue()  # type: ignore[attr-defined]
