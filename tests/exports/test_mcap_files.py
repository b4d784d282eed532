"""MCAP files, read back by the mcap package."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.datasets import write_dataset
from tepm_opt.data.tables import write_columns
from tepm_opt.errors import InputError
from tepm_opt.exports.mcap_files import export_mcap
from tests.data.made import make_dataset

reader = pytest.importorskip("mcap.reader", reason="mcap is not installed (extra mcap)")


def messages(path: Path, topic: str) -> tuple[list[int], list[dict[str, Any]]]:
    """Times in ns and contents of a topic."""
    with path.open("rb") as file:
        found = [(message.log_time, json.loads(message.data)) for _, _, message in reader.make_reader(file).iter_messages(topics=[topic])]
    return [at for at, _ in found], [content for _, content in found]


def test_a_log_comes_back_whole(tmp_path: Path) -> None:
    """Numbers to the last bit, text, gaps; points that were not seen are not shown."""
    time = np.array([-0.5, 0.01, 1 / 3])
    columns = {"time_s": time, "s1_x_m": np.array([0.1, np.nan, 1e-17]), "s1_y_m": time, "s1_z_m": time, "end": np.array(["a", "b", "c"])}
    write_columns(tmp_path / "log.csv", columns)
    (path,) = export_mcap(tmp_path / "log.csv", tmp_path / "out")
    times, rows = messages(path, "/log")
    assert times == [0, 510_000_000, 833_333_333]
    for name, values in columns.items():
        assert [row[name] for row in rows] == [None if value != value else value for value in values.tolist()]
    poses = [message["poses"] for message in messages(path, "/points")[1]]
    assert [len(row) for row in poses] == [1, 0, 1]
    assert poses[2][0]["position"] == {"x": 1e-17, "y": 1 / 3, "z": 1 / 3}
    with path.open("rb") as file:
        schemas = {schema.name: json.loads(schema.data) for schema in reader.make_reader(file).get_summary().schemas.values()}
    assert set(schemas["tepm_opt.Log"]["properties"]) == set(columns)
    assert "foxglove.PosesInFrame" in schemas


def test_a_data_set_is_a_file_a_run(tmp_path: Path) -> None:
    dataset = make_dataset()
    write_dataset(dataset, tmp_path / "data")
    files = export_mcap(tmp_path / "data", tmp_path / "out")
    assert [path.stem for path in files] == [Path(run.file).stem for run in dataset.runs]
    for path, run in zip(files, dataset.runs, strict=True):
        rows = messages(path, "/log")[1]
        np.testing.assert_array_equal([row["tension_23_N"] for row in rows], run.inputs[:, 11])
        assert len(messages(path, "/points")[1][0]["poses"]) == 4


@pytest.mark.parametrize(
    ("text", "says"),
    [("a,b\n1,2\n", "column 'time_s' is missing"), ("time_s,a\n1,2\n1,3\n", "line 3: time_s = 1"), ("", "is empty")],
)
def test_what_is_no_log_is_refused(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=says):
        export_mcap(tmp_path / "log.csv", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_without_mcap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(InputError, match="pip install 'tepm-opt\\[mcap\\]'"):
        export_mcap(tmp_path / "log.csv", tmp_path / "out")
