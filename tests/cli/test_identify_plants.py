"""Parameters of any machine: `tepm identify DATASET --plant FILE`."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tepm_opt.errors import InputError
from tepm_opt.jobs.identify import open_trials, run_identify_plant
from tepm_opt.jobs.plants import load_plant
from tests.cli.conftest import Command
from tests.discrepancy.test_quick_plants import NOISE, runs
from tests.tank import write_plant, write_tank


@pytest.fixture
def tank(tmp_path: Path) -> Path:
    """Levels of a tank that leaks 2.6 per second instead of 2, with `tank.py` beside them."""
    write_plant(tmp_path / "tank.py", within=0.9)
    return write_tank(tmp_path / "data", runs(3, leak=2.6), NOISE)


def test_the_leak_is_found_within_its_interval(tank: Path) -> None:
    plant = load_plant(tank.with_name("tank.py"))
    found = run_identify_plant(plant, open_trials([tank], plant)).summary()
    leak = found["parameters"]["leak"]
    assert leak["low"] < 2.6 < leak["high"]
    assert leak["value"] == pytest.approx(2.6, rel=0.01)
    assert found["residual_over_noise"] == pytest.approx(1, abs=0.1)
    assert found["validation_over_noise"]["after"] == pytest.approx(1, abs=0.15)
    assert found["validation_over_noise"]["before"] > 3


def test_two_data_sets_are_fitted_together(tank: Path) -> None:
    other = write_tank(tank.with_name("more"), runs(3, leak=2.6, seed=9), NOISE)
    plant = load_plant(tank.with_name("tank.py"))
    alone, both = (run_identify_plant(plant, open_trials(sets, plant)).estimate.std[0] for sets in ([tank], [tank, other]))
    assert 0.5 < both / alone < 0.9  # twice the data


def test_an_unknown_parameter_is_refused(tank: Path) -> None:
    plant = load_plant(tank.with_name("tank.py"))
    with pytest.raises(InputError, match=r"unknown parameter 'leek'.*leak"):
        run_identify_plant(plant, open_trials([tank], plant), ["leek"])


def test_command(tepm: Command, tank: Path) -> None:
    done = tepm("identify", str(tank), "--plant", str(tank.with_name("tank.py")), "--out", str(tank.with_name("out")))
    assert (done.status, done.err) == (0, "")
    assert "times the noise before" in done.out
    assert json.loads((tank.with_name("out") / "values.json").read_text()) == {"leak": pytest.approx(2.6, rel=0.01)}


@pytest.mark.parametrize("option", [("--robot", "kang2017"), ("--starts", "2", "--jobs", "2")])
def test_options_of_robots_are_refused(tepm: Command, tank: Path, option: tuple[str, ...]) -> None:
    assert "--plant excludes --robot" in tepm("identify", str(tank), "--plant", "tank.py", *option).err


def test_a_posterior_is_the_prior_of_the_next_fit(tepm: Command, tank: Path) -> None:
    """Two recordings one after the other tell what both together do."""
    folder, plant = tank.parent, load_plant(tank.with_name("tank.py"))
    other = write_tank(folder / "more", runs(3, leak=2.6, seed=9), NOISE)
    machine = ("--plant", str(folder / "tank.py"))
    assert tepm("identify", str(tank), *machine, "--out", str(folder / "first")).status == 0
    prior = ("--prior", str(folder / "first" / "posterior.json"))
    assert tepm("identify", str(other), *machine, *prior, "--out", str(folder / "second")).status == 0
    told = json.loads((folder / "second" / "posterior.json").read_text())
    both = run_identify_plant(plant, open_trials([tank, other], plant)).estimate
    assert (told["parameters"][0]["name"], told["parameters"][0]["unit"]) == ("leak", "1/s")
    assert told["parameters"][0]["mean"] == pytest.approx(both.values[0], abs=0.2 * both.std[0])
    assert told["covariance"][0][0] == pytest.approx(both.covariance[0, 0], rel=0.2)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", r"posterior\.json: is damaged: .*; run tepm identify again"),
        ("{}", r"posterior\.json: no posterior: KeyError\('parameters'\); valid: parameters \(name, mean, unit\) and covariance"),
        ('{"parameters": [{"name": "leak", "mean": 2}], "covariance": [[-1]]}', r"covariance: is none; valid: finite, symmetric, positive"),
        ('{"parameters": [{"name": "leak", "mean": 2}], "covariance": [[1, 0]]}', r"covariance: \(1, 2\) for 1 parameters"),
        ('{"parameters": [{"name": "leek", "mean": 2}], "covariance": [[1]]}', r"prior: unknown parameter 'leek': did you mean 'leak'"),
    ],
)
def test_a_posterior_that_is_none_is_refused(tepm: Command, tank: Path, text: str, says: str) -> None:
    file = tank.with_name("posterior.json")
    file.write_text(text, encoding="utf-8")
    done = tepm("identify", str(tank), "--plant", str(tank.with_name("tank.py")), "--prior", str(file), "--out", str(tank.with_name("out")))
    assert done.status == 2
    assert re.search(says, done.err)


def test_a_posterior_that_is_not_there_is_told_once(tepm: Command, tank: Path) -> None:
    done = tepm("identify", str(tank), "--plant", str(tank.with_name("tank.py")), "--prior", "no.json", "--out", str(tank.with_name("out")))
    assert (done.status, done.err.strip()) == (2, "error: no.json: cannot be read: No such file or directory")
