"""A guessed map, and after it nothing but the entries that refusals propose, lead to a data set."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.importing.guess import orientations
from tepm_opt.data.importing.sources import Sheet
from tepm_opt.errors import InputError
from tepm_opt.jobs.import_data import run_import, suggest_map
from tests.data.importing.layouts import LAYOUTS
from tests.data.importing.test_refusals import entries, merged, write_map
from tests.data.importing.truth import COMMANDS, signals

LED = {
    "german_spreadsheet": 0,
    "pneumatic_only_with_quaternions": 0,
    "stacked_runs": 1,
    "trials_in_one_file": 1,
    "dates_in_latin_1": 0,
    "parquet": 0,
    "matlab_structure": 1,
    "rows_without_time": 1,
}
"""Layouts, and how many refusals stand between their guessed map and their data set."""


@pytest.mark.parametrize("name", LED)
def test_refusals_lead_from_a_guess_to_a_data_set(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    foreign = LAYOUTS[name](tmp_path)
    content = tomllib.loads(suggest_map(foreign.files))
    steps = 0
    while True:
        try:
            run = run_import(foreign.files, write_map(tmp_path / "map.toml", content))
        except InputError as error:
            proposed = entries(str(error))
            if not proposed:
                raise
            for entry in proposed:
                content = merged(content, tomllib.loads(entry))
            steps += 1
            assert steps < 5
        else:
            break
    assert steps == LED[name]
    assert run.dataset is not None
    first = run.dataset.runs[0]
    if name not in ("rows_without_time", "trials_in_one_file"):  # the rate, absolute pressure: nobody can guess those
        assert first.inputs[:, 0] == pytest.approx(signals(first.time)[COMMANDS[0]], rel=1e-6)


def test_orientations_are_known_by_their_values() -> None:
    """Quaternions and rotation matrices have lengths that nothing else has."""
    angle = np.linspace(0.1, 1.0, 50)
    none, one = np.zeros(50), np.ones(50)
    turn = [np.cos(angle), -np.sin(angle), none, np.sin(angle), np.cos(angle), none, none, none, one]
    columns = [angle, 0.1 + angle, np.cos(angle / 2), none, none, np.sin(angle / 2), 0.3 * angle, *turn, 0.4 * angle]
    sheet = Sheet(
        Path("a.csv"), {str(k + 1): values for k, values in enumerate(columns)}, order=tuple(str(k + 1) for k in range(len(columns)))
    )
    assert orientations(sheet) == ["3", "4", "5", "6", *(str(k) for k in range(8, 17))]
