"""Data sets of one machine as one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.channels import Channels
from tepm_opt.data.datasets import DataSet
from tepm_opt.data.run import Run
from tepm_opt.errors import InputError
from tepm_opt.jobs.discrepancy import checked_datasets
from tepm_opt.jobs.joined import concatenate_datasets
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.robot import load_robot, robot_text
from tests.discrepancy.small import dataset_of, write


def run(file: str, began: float = 0.0) -> Run:
    time = np.arange(51) / 50
    return Run(file, "fit", time, np.zeros((51, 12)), np.zeros((51, 3)), np.zeros((51, 4, 3)), began=began)


def dataset(*files: str, robot: str = "kang2017", noise: float | None = 3e-4) -> DataSet:
    runs = tuple(run(file, 6.0 * k) for k, file in enumerate(files))
    return DataSet("set", robot, channels_of(load_robot("kang2017")), runs, 50.0, noise)


def test_runs_are_named_after_their_folder_and_go_on_in_time() -> None:
    found = concatenate_datasets(
        dataset("a.csv", "b.csv"), [(Path("x/extra"), dataset("a.csv", "c.csv")), (Path("y/extra"), dataset("a.csv"))]
    )
    assert [each.file for each in found.runs] == ["a.csv", "b.csv", "extra_a.csv", "extra_c.csv", "extra-2_a.csv"]
    began = [each.began for each in found.runs]
    assert began[:2] == [0.0, 6.0]
    assert began[2] == pytest.approx(6.0 + 1.0 + 5.0)
    assert np.all(np.diff(began) > 1.0)


def test_nothing_added_is_the_same() -> None:
    first = dataset("a.csv")
    assert concatenate_datasets(first, []) is first


def test_a_copy_of_the_robot_file_is_the_same_robot(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text(robot_text("kang2017"), encoding="utf-8")
    found = concatenate_datasets(dataset("a.csv"), [(Path("extra"), dataset("b.csv", robot=str(tmp_path / "robot.toml"), noise=None))])
    assert found.runs[1].file == "extra_b.csv"
    assert (found.robot, found.position_noise) == ("kang2017", 3e-4)


def other_robot(folder: Path) -> DataSet:
    (folder / "robot.toml").write_text(robot_text("kang2017").replace("m_d = 0.22", "m_d = 0.25"), encoding="utf-8")
    return dataset("b.csv", robot=str(folder / "robot.toml"))


WRONG = {
    "another robot": (other_robot, r"extra: its robot is .*robot\.toml', not 'kang2017'; valid: more data of the same machine"),
    "other columns": (
        lambda folder: replace(dataset(), channels=Channels(("11",), ("s1",))),
        "extra: its robot is 'kang2017', not 'kang2017'; valid: more data of the same machine",
    ),
    "equilibria": (lambda folder: replace(dataset("b.csv"), static=True), "extra: its rows are equilibria, those before motion"),
    "another noise": (lambda folder: dataset("b.csv", noise=5e-4), "extra: position_noise_m = 0.0005 m; valid: 0.0003 m"),
    "another rate": (lambda folder: replace(dataset("b.csv"), sample_rate=25.0), "extra: sample_rate_hz = 25 Hz; valid: 50 Hz"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_fit_is_refused_with_its_folder(tmp_path: Path, name: str) -> None:
    make, message = WRONG[name]
    with pytest.raises(InputError, match=message):
        concatenate_datasets(dataset("a.csv"), [(Path("extra"), make(tmp_path))])


def test_warnings_of_added_data_name_their_folder(kang: CompiledModel, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    noisy = replace(run("a.csv"), points=np.linspace(0.1, 0.3, 4)[:, None] + 3e-4 * random.normal(size=(51, 4, 3)))
    folders = [write(dataset_of(kang, [noisy]), tmp_path / name) for name in ("first", "extra")]
    found, _ = checked_datasets(folders, despite_errors=True)
    assert [each.file for each in found.runs] == ["a.csv", "extra_a.csv"]
