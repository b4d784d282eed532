"""Random machines with random data: a verdict or one clear line, nothing else, and no number that is none in what is written."""

from __future__ import annotations

import json
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt import plots
from tepm_opt.errors import InputError
from tepm_opt.jobs import discrepancy as job
from tepm_opt.report.discrepancy import write_discrepancy_page
from tests.discrepancy.random_machines import data, machine

QUICK, ALL, LONG = 10, 200, (2, 4, 7)
"""Seeds of every run, of all, and those of every run that take seconds."""
NO_NUMBER = re.compile(r"\b(nan|inf|NaN|Infinity)\b")


def numbers(content: Any) -> list[float]:
    """All numbers of a JSON document."""
    if isinstance(content, dict | list):
        return [number for each in (content.values() if isinstance(content, dict) else content) for number in numbers(each)]
    return [content] if isinstance(content, float) else []


def check(seed: int, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """What became of a case: its status, or the line that refuses it."""
    random = np.random.default_rng(seed)
    plant, step = machine(random)
    where = data(random, plant, step, folder / "data")
    (folder / "plant.py").write_text("")
    monkeypatch.setattr(job, "load_plant", lambda path: plant)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            found = job.run_discrepancy(where, folder / "out", plant=folder / "plant.py", options=job.DiscrepancyOptions(seed))
            pictures = plots.draw(found, folder / "out")
            write_discrepancy_page(folder / "out" / "report.html", found.verdict, found.localisation, pictures, {"seed": str(seed)})
    except InputError as error:
        return f"refused: {error}"
    verdict = json.loads((folder / "out" / "verdict.json").read_text(encoding="utf-8"), parse_constant=lambda name: pytest.fail(name))
    values = json.loads((folder / "out" / "values.json").read_text(encoding="utf-8"), parse_constant=lambda name: pytest.fail(name))
    assert np.isfinite(numbers(verdict) + numbers(values)).all()
    page = re.sub(
        r"<style.*?</style>|<script.*?</script>|base64,[^\"]*|<[^>]*>",
        " ",
        (folder / "out" / "report.html").read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    for text in (verdict["paragraph"], *verdict["notes"], page):
        assert not NO_NUMBER.search(text), text
    for effect in verdict["effects"]:
        assert 0 <= effect["probability"] <= 1
    return str(verdict["status"])


@pytest.mark.sample(3)
@pytest.mark.parametrize("seed", [seed for seed in range(QUICK) if seed not in LONG])
def test_a_verdict_or_a_line(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert re.fullmatch(r".{1,600}", check(seed, tmp_path, monkeypatch))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*LONG, *range(QUICK, ALL)])
def test_a_verdict_or_a_line_many(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert re.fullmatch(r".{1,600}", check(seed, tmp_path, monkeypatch))
