"""Data frames: there and back without loss, and a clear line where pandas is not installed."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.data.channels import Channels
from tepm_opt.data.frames import dataset_from_frame, dataset_to_frame, run_from_frame, run_to_frame
from tepm_opt.errors import InputError
from tests.data.made import NAMES, make_dataset
from tests.data.test_datasets import assert_same, assert_same_run


def test_without_pandas(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    for call in (lambda: run_to_frame(make_dataset().runs[0], NAMES), lambda: dataset_to_frame(make_dataset())):
        with pytest.raises(InputError, match="data frames need pandas, which is not installed: pip install pandas"):
            call()


class TestWithPandas:
    @pytest.fixture(autouse=True)
    def _pandas(self) -> None:
        pytest.importorskip("pandas")

    def made(self):
        dataset = make_dataset()
        points = dataset.runs[0].points.copy()
        points[5, 2] = np.nan
        extra = {"pressure_11_measured_Pa": np.linspace(0, 1, 300), "remark": np.array(["start", *[""] * 298, "end"])}
        return replace(dataset, runs=(replace(dataset.runs[0], points=points, extra=extra), dataset.runs[1]))

    def test_a_run(self) -> None:
        run = self.made().runs[0]
        frame = run_to_frame(run, NAMES)
        assert list(frame.columns) == [*NAMES.columns, "pressure_11_measured_Pa", "remark"]
        assert_same_run(run_from_frame(frame, "steps.csv"), run)

    def test_a_data_set(self) -> None:
        dataset = self.made()
        frame = dataset_to_frame(dataset)
        assert list(frame.columns[:3]) == ["file", "role", "time_s"]
        assert len(frame) == 600
        assert_same(dataset_from_frame(frame, dataset), dataset)

    def test_equilibria(self) -> None:
        dataset = self.made()
        runs = tuple(replace(run, time=np.full(300, np.nan)) for run in dataset.runs)
        static = replace(dataset, runs=runs, static=True, sample_rate=None)
        assert "time_s" not in dataset_to_frame(static).columns
        assert_same(dataset_from_frame(dataset_to_frame(static), static), static)

    def test_no_runs(self) -> None:
        empty = replace(make_dataset(), runs=())
        assert_same(dataset_from_frame(dataset_to_frame(empty), empty), empty)

    def test_wrong_frames(self) -> None:
        dataset = make_dataset()
        frame = dataset_to_frame(dataset)
        with pytest.raises(InputError, match="column 'role' is missing"):
            dataset_from_frame(frame.drop(columns="role"), dataset)
        mixed = frame.copy()
        mixed.loc[3, "role"] = "validation"
        with pytest.raises(InputError, match="has the roles fit, validation"):
            dataset_from_frame(mixed, dataset)
        with pytest.raises(InputError, match="column 's1_x_m' is missing"):
            run_from_frame(frame.drop(columns=["file", "role", "s1_x_m"]), "a.csv", channels=NAMES)
        text = frame.drop(columns=["file", "role"]).astype({"time_s": str})
        with pytest.raises(InputError, match=r"a\.csv: column 'time_s' holds"):
            run_from_frame(text, "a.csv")

    def test_integers_and_other_columns(self) -> None:
        frame = run_to_frame(make_dataset().runs[0], NAMES).astype({"pressure_11_Pa": int})
        frame["count"] = range(300)
        run = run_from_frame(frame, "a.csv", "validation")
        assert run.extra["count"].dtype == float
        assert Channels.from_header(frame.columns) == NAMES
