"""`tepm identify` and `tepm discrepancy`: files, exit status, what they refuse; their models in every other command."""

from __future__ import annotations

import json
import shlex
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.effects import effects
from tepm_opt.models.model import Model, read_model, write_model
from tests.cli.conftest import Command
from tests.cli.tables import input_columns, names_in, summary, table, tips, values, write_rows
from tests.discrepancy.small import changed, cut, dataset_of, measured, planned, true_values
from tests.tools import with_all_effects, with_effect

NOMINAL = Model.from_robot("kang2017")
RANGE = np.repeat([0.5e6, 7.0], 6)
FIGURES = {"heat.png", "gap.png", "points.png", "over_time.png", "tip.png"}
OFFSET = np.array([4e-3, -3e-3, 2e-3])  # m, of s3
PRESSURES = np.array([1.6e5, 1.9e5, 1.75e5, 1.5e5, 1.7e5, 1.6e5])  # Pa, above every threshold
TENSIONS = np.array([1.0, 1.5, 1.2, 0.8, 1.1, 1.4])  # N, beyond every slack


@pytest.fixture(scope="session")
def sound(kang: CompiledModel) -> DataSet:
    """Short runs of a machine in which nothing is missing."""
    runs = measured(changed(kang, **true_values(kang)), planned(("single_pressure.csv", "elongation.csv", "mixed.csv")))
    return dataset_of(kang, [cut(run, 3.0) for run in runs])


@pytest.fixture
def data(here: Path, sound: DataSet) -> Path:
    """The sound data set in the working folder."""
    write_dataset(sound, here / "data")
    return here / "data"


def spoilt(folder: Path) -> None:
    """The holder of s3 is off in all runs."""
    for path in folder.glob("*.csv"):
        header, rows = table(path)
        at = [header.index(f"s3_{axis}_m") for axis in "xyz"]
        rows[:, at] += OFFSET
        write_rows(path, header, rows)


class TestIdentify:
    def test_finds_the_parameters(self, tepm: Command, here: Path, data: Path, kang: CompiledModel) -> None:
        done = tepm("identify", "data", "--out", "out")
        assert (done.status, done.err) == (0, "")
        assert names_in(here / "out") == {"model.toml", "identified.json", "posterior.json"}
        found = json.loads((here / "out" / "identified.json").read_text())
        assert found["converged"]
        assert found["residual_over_noise"] == pytest.approx(1.0, abs=0.03)
        for name, truth in true_values(kang).items():
            entry = found["parameters"][name]
            assert abs(entry["value"] - truth) < 3 * entry["std"] + 0.005 * truth, name
            assert entry["low"] <= entry["value"] <= entry["high"]
            assert name in done.out
        errors = found["validation_rmse_m"]
        assert errors["after"] < 0.6e-3 < errors["before"]
        model = read_model(here / "out" / "model.toml")
        assert model.parameters == {name: entry["value"] for name, entry in found["parameters"].items()}

    @pytest.mark.slow
    def test_json_on_the_standard_output(self, tepm: Command, here: Path, data: Path) -> None:
        done = tepm("identify", "data", "--free", "K_a, m_d", "--plain", "--json")
        assert done.status == 0
        assert done.json() == json.loads((here / "identified" / "identified.json").read_text())
        assert list(done.json()["parameters"]) == ["K_a", "m_d"]

    @pytest.mark.slow
    def test_what_parameters_do_not_explain(self, tepm: Command, here: Path, data: Path) -> None:
        """A holder that is off: status 1, why, and the command that finds out; the model is written all the same."""
        spoilt(data)
        done = tepm("identify", "data", "--out", "out")
        assert done.status == 1
        found = json.loads((here / "out" / "identified.json").read_text())
        assert found["converged"]
        assert found["residual_over_noise"] > 3
        assert (
            found["doubts"][0]
            == f"residuals are {found['residual_over_noise']:.3g} times the noise: these parameters do not explain the runs"
        )
        assert found["doubts"][0] in done.out
        assert done.out.endswith("\nNext: find out what the model lacks: tepm discrepancy data --out found\n")
        assert read_model(here / "out" / "model.toml").parameters

    @pytest.mark.slow
    def test_a_parameter_at_its_bound(self, tepm: Command, here: Path, data: Path) -> None:
        """Mass that is not there: the fit is not asked for stiffness, so that the mass goes as far as its prior lets it."""
        write_model(NOMINAL.with_parameters(K_a=345.0), here / "stiff.toml")
        done = tepm("identify", "data", "--free", "m_d", "--model", "stiff.toml")
        assert done.status == 1
        assert "at the end of what is thought possible: m_d: they may stand in for something else" in done.out.replace("\n", " ")
        assert "tepm discrepancy data --model stiff.toml --out found" in done.out

    @pytest.mark.slow
    def test_a_model_with_an_effect(self, tepm: Command, here: Path, data: Path) -> None:
        spoilt(data)
        write_model(NOMINAL.with_effect("sensor_offset", "s3", x=0.0, y=0.0, z=0.0), here / "m.toml")
        names = [f"sensor_offset[s3].{axis}" for axis in "xyz"]
        done = tepm("identify", "data", "--model", "m.toml", "--free", ",".join(["K_a", *names]), "--out", "out")
        assert done.status == 1, "K_a is at its end"
        found = read_model(here / "out" / "model.toml").values
        assert [found[name] for name in names] == pytest.approx(OFFSET, abs=3e-4)

    @pytest.mark.parametrize(
        ("options", "says"),
        [
            ("data --free K_b", ("'K_b'", "K_a")),
            ("data --free payload.mass", ("'payload.mass'",)),
            ("data --starts 0", ("--starts", "0")),
            ("data --robot kang2017 --model m.toml", ("--robot", "--model")),
            ("data --robot nobody", ("'nobody'",)),
            ("data --model absent.toml", ("absent.toml",)),
            ("absent", ("absent",)),
            ("", ("DATASET",)),
        ],
    )
    def test_wrong_options(self, tepm: Command, here: Path, data: Path, options: str, says: tuple[str, ...]) -> None:
        write_model(NOMINAL, here / "m.toml")
        refused(tepm("identify", *shlex.split(options), "--out", "out"), says)
        assert not (here / "out").exists()

    def test_data_that_the_check_refuses(self, tepm: Command, data: Path) -> None:
        text = (data / "mixed.csv").read_text().splitlines()
        (data / "mixed.csv").write_text("\n".join([*text[:40], text[39], *text[40:]]) + "\n")
        refused(tepm("identify", "data"), ("mixed.csv", "copy of the row before"))


class TestDiscrepancy:
    @pytest.mark.slow
    def test_nothing_is_missing(self, tepm: Command, here: Path, data: Path) -> None:
        done = tepm("discrepancy", "data", "--out", "out")
        assert done.status == 0, done.err
        assert names_in(here / "out") == {"verdict.json", "model.toml", "report.html", *FIGURES}
        assert done.out.startswith("no_discrepancy\n")
        assert "fitting the known parameters" in done.err
        verdict = json.loads((here / "out" / "verdict.json").read_text())
        assert verdict["status"] == "no_discrepancy"
        assert verdict["command"].startswith("tepm simulate data/")
        assert f"Next: {verdict['next']}: {verdict['command']}\n" in done.out
        assert len(set(verdict["notes"])) == len(verdict["notes"])
        assert verdict["effects"] == []
        assert read_model(here / "out" / "model.toml").parameters

    @pytest.mark.slow
    def test_a_missing_effect_and_its_model_elsewhere(self, tepm: Command, here: Path, data: Path) -> None:
        spoilt(data)
        done = tepm("discrepancy", "data", "--out", "out", "--json")
        assert (done.status, done.err) == (0, "")
        verdict = done.json()
        assert verdict == json.loads((here / "out" / "verdict.json").read_text())
        assert [(effect["name"], effect["detail"]) for effect in verdict["effects"]] == [("sensor_offset", "s3")]
        head, row, *_ = verdict["table"]
        assert dict(zip(head, row, strict=True))["effect"] == "sensor_offset"
        page = (here / "out" / "report.html").read_text()
        assert all(f">{escape(cell)}<" in page for line in verdict["table"] for cell in line[1:])
        assert escape(verdict["answer"]) in page
        assert verdict["answer"] in verdict["paragraph"]
        assert names_in(here / "out") == {"verdict.json", "model.toml", "report.html", "evidence.png", *FIGURES}
        assert "sensor_offset" in (here / "out" / "report.html").read_text()
        assert tepm("statics", "--model", "out/model.toml", "--out", "still").status == 0

    @pytest.mark.slow
    def test_unexplained_is_status_1(self, tepm: Command, here: Path, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Points that leap about: no effect does that, none is looked for."""
        for path in data.glob("*.csv"):
            header, rows = table(path)
            rows[:, -12:] += 4e-3 * np.sin(40 * rows[:, :1] + np.arange(12))
            write_rows(path, header, rows)
        monkeypatch.setattr("tepm_opt.discrepancy.adapters.network.candidates", lambda model: ())
        done = tepm("discrepancy", "data", "--despite-errors")
        assert done.status == 1, done.err
        assert done.out.startswith("unexplained\n")
        assert "Next: " in done.out
        assert json.loads((here / "discrepancy" / "verdict.json").read_text())["status"] == "unexplained"

    @pytest.mark.slow
    def test_interrupted(self, tepm: Command, here: Path, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def interrupted(*arguments: Any, **options: Any) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr("tepm_opt.jobs.discrepancy.discover", interrupted)
        done = tepm("discrepancy", "data", "--out", "out")
        assert (done.status, done.out) == (130, "")
        assert done.err.splitlines()[-1].startswith("interrupted: finished fits are kept in out")

    @pytest.mark.parametrize(
        ("options", "says"),
        [
            ("data --model absent.toml", ("absent.toml",)),
            ("data --seed one", ("--seed", "integer")),
            ("data --robot kang2017", ("--robot",)),
            ("data --out data/mixed.csv", ("data/mixed.csv", "file")),
            ("absent", ("absent",)),
            ("here", ("here", "dataset.toml")),
            ("", ("DATASET",)),
        ],
    )
    def test_wrong_options(self, tepm: Command, here: Path, data: Path, options: str, says: tuple[str, ...]) -> None:
        (here / "here").mkdir()
        refused(tepm("discrepancy", *shlex.split(options)), says)
        assert names_in(here) == {"data", "here"}


def refused(done: Any, says: tuple[str, ...]) -> None:
    """One line, exit status 2."""
    assert (done.status, done.out) == (2, ""), done.err
    line = done.err.strip().splitlines()[-1]
    assert line.startswith("error:")
    assert all(text in line for text in says), line


EVERY = {"all at once": with_all_effects(NOMINAL)} | {effect.name: with_effect(NOMINAL, effect) for effect in effects()}


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_map")
@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name == "all at once" else pytest.mark.slow) for name in EVERY])
def test_every_effect_in_every_command(tepm: Command, here: Path, name: str) -> None:
    """`ik`, `gain`, `statics` and `simulate` take effects; G with them agrees with differences of `statics`."""
    write_model(EVERY[name], here / "m.toml")
    u = np.append(PRESSURES, TENSIONS)
    write_rows(here / "in.csv", input_columns(), np.column_stack([[0.0, 0.2], np.tile(u, (2, 1)) * [[1.0], [1.05]]]))
    step = 1e-3 * RANGE
    moves = np.vstack([u, u + np.diag(step), u - np.diag(step)])
    write_rows(here / "moved.csv", input_columns(), np.column_stack([np.arange(25), moves]))

    for command in ("statics moved.csv --out still", "gain in.csv --out gain", "simulate in.csv --out motion --animation none"):
        done = tepm(*shlex.split(command), "--model", "m.toml")
        assert (done.status, done.err) == (0, ""), command
    rest, *moved = tips(here / "still")
    forth, back = np.split(np.array(moved), 2)
    G = values(here / "gain" / "gain.csv")[0].reshape(3, 12) * RANGE
    assert np.abs(G - ((forth - back) / 2e-3).T).max() <= 2e-4 * np.abs(G).max()
    np.testing.assert_allclose(values(here / "motion" / "trajectory.csv")[0, -3:], rest, atol=1e-8)

    write_rows(here / "target.csv", ["x", "y", "z"], rest[None] + [0.002, -0.001, 0.003])
    done = tepm("ik", "target.csv", "--model", "m.toml", "--out", "ik")
    assert (done.status, done.err) == (0, ""), done.out
    assert summary(here / "ik", "ik")["solved"] == 1
    assert np.linalg.norm(tips(here / "ik")[0] - values(here / "target.csv")[0]) < 1e-6
