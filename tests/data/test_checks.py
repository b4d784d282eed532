"""The check of data: silent where nothing is wrong, however noisy; what it says of doubtful data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.cli import run as tepm
from tepm_opt.data.checks.dataset import check_dataset, check_reading
from tepm_opt.data.checks.findings import Finding
from tepm_opt.data.datasets import DataSet, read_dataset, read_folder, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.models.channels import check, open_dataset
from tests.data.made import CHANNELS, NAMES, make_dataset, make_run
from tests.paths import SHARED, reference

BLIND = sorted(path.name for path in (SHARED / "blind").glob("set_*")) or ["set_01"]


def errors(findings: list[Finding]) -> list[Finding]:
    return [finding for finding in findings if finding.severity == "error"]


def changed(**arrays: np.ndarray) -> DataSet:
    """The set made by hand, known robot, with other arrays in its first run."""
    dataset = replace(make_dataset(), channels=CHANNELS)
    return replace(dataset, runs=(replace(dataset.runs[0], **arrays), dataset.runs[1]))


def moved(change: Callable[[np.ndarray], object]) -> DataSet:
    """… with other points."""
    points = make_dataset().runs[0].points.copy()
    change(points)
    return changed(points=points)


class TestSilence:
    @pytest.mark.sample(7)
    @pytest.mark.parametrize("name", BLIND)
    def test_blind_sets(self, name: str) -> None:
        """All 18 effects, foreign ones and pairs are physics, not faults of the data."""
        folder = SHARED / "blind" / name
        if not folder.exists():
            pytest.skip(f"{folder} is not on this machine")
        assert check(folder) == []

    @pytest.mark.slow
    def test_the_null_set_with_and_without_its_robot(self) -> None:
        assert check(reference("null")) == []
        assert check_reading(read_folder(reference("null"))) == []

    @pytest.mark.sample(5)
    @pytest.mark.parametrize(
        ("noise", "grid"), [(1e-5, 0.0), (1e-5, 1e-4), (2e-4, 0.0), (2e-4, 1e-4), (5e-4, 1e-5), (1e-3, 0.0), (1e-3, 1e-3)]
    )
    def test_noise_and_resolution(self, noise: float, grid: float) -> None:
        dataset = open_dataset(reference("null"))
        random = np.random.default_rng(int(1e6 * noise))
        noisy = []
        for run in dataset.runs:
            points = run.points + noise * random.normal(size=run.points.shape)
            noisy.append(replace(run, points=np.round(points / grid) * grid if grid else points))
        assert check_dataset(replace(dataset, runs=tuple(noisy), position_noise=None)) == []

    def test_dropouts_of_a_tracker(self) -> None:
        dataset = open_dataset(reference("null"))
        random, runs = np.random.default_rng(3), []
        for run in dataset.runs:
            points = run.points + 5e-4 * random.normal(size=run.points.shape)
            points[random.random(points.shape[:2]) < 0.05] = np.nan
            runs.append(replace(run, points=points))
        findings = check_dataset(replace(dataset, runs=tuple(runs), position_noise=5e-4))
        assert errors(findings) == []
        assert {finding.channel for finding in findings} == {"s1", "s2", "s3", "s4"}
        shares = [float(finding.message.split("dropouts: ")[1].split(" %")[0]) for finding in findings]
        assert len(shares) == 28
        assert all(3 < share < 7 for share in shares)

    def test_a_coarse_tracker_gives_some_poses_twice(self) -> None:
        """A single point at rest, read in steps of a third of its noise."""
        dataset = make_dataset()
        coarse = tuple(replace(run, points=np.round(run.points[:, :1] / 1e-4) * 1e-4) for run in dataset.runs)
        assert check_dataset(replace(dataset, runs=coarse, channels=replace(NAMES, points=NAMES.points[:1]))) == []

    @pytest.mark.slow
    def test_another_rate(self) -> None:
        """Half the rows of the null set, and rows between them."""
        dataset = open_dataset(reference("null"))
        half = [
            replace(r, time=r.time[::2], inputs=r.inputs[::2], tip_force=r.tip_force[::2], points=r.points[::2], lines=())
            for r in dataset.runs
        ]
        assert check_dataset(replace(dataset, runs=tuple(half), sample_rate=25.0)) == []
        runs = []
        for run in dataset.runs:
            time = np.linspace(0, run.time[-1], 4 * (run.rows - 1) + 1)

            def dense(values: np.ndarray, old: np.ndarray = run.time, new: np.ndarray = time) -> np.ndarray:
                columns = values.reshape(len(values), -1).T
                return np.stack([np.interp(new, old, column) for column in columns], axis=1).reshape(len(new), *values.shape[1:])

            random = np.random.default_rng(4)
            points = dense(run.points) + 5e-4 * random.normal(size=(len(time), 4, 3))
            runs.append(replace(run, time=time, inputs=dense(run.inputs), tip_force=dense(run.tip_force), points=points, lines=()))
        assert check_dataset(replace(dataset, runs=tuple(runs), sample_rate=200.0, position_noise=5e-4)) == []

    @pytest.mark.parametrize("seed", range(5))
    def test_sets_made_by_hand(self, seed: int) -> None:
        runs = tuple(make_run(f"{k}.csv", "validation" if k % 2 else "fit", 10 * seed + k, noise=1e-3) for k in range(4))
        assert check_dataset(DataSet("made", "kang2017", CHANNELS, runs, 50.0, 1e-3)) == []


STEPS = make_dataset().runs[0]
ARRAYS = ("time", "inputs", "tip_force", "points")
BUSY = NAMES.inputs[6 + int(np.argmax(np.ptp(STEPS.inputs[:, 6:], axis=0)))].replace("_N", "_measured_N")


def of_steps(select: Callable[[np.ndarray], np.ndarray]) -> dict[str, np.ndarray]:
    """All arrays of the first run, with some rows taken."""
    return {name: select(getattr(STEPS, name)) for name in ARRAYS}


def in_kilopascal() -> dict[str, np.ndarray]:
    return {f"pressure_{name}_measured_Pa": u / 1e3 for name, u in zip(NAMES.actuators, STEPS.inputs.T[:6], strict=True)}


def uneven() -> np.ndarray:
    return np.arange(300) * 0.02 + np.where(np.arange(300) % 5 == 0, 0.006, 0.0)


def gone(points: np.ndarray) -> None:
    points[100:103, 2] = np.nan
    points[200:210, 2] = np.nan


def cold(points: np.ndarray) -> None:
    points[:, 1] = points[0, 1] + 3e-4 * np.random.default_rng(0).normal(size=(300, 3))


def sideways(points: np.ndarray) -> None:
    points[:] = points[:, :, [2, 1, 0]] + [0.05, 0, -0.05]


def twice(points: np.ndarray) -> None:
    points[1::2] = points[::2]


DOUBTS = {
    "dropouts": (
        lambda: moved(gone),
        "warning",
        "s3",
        "dropouts: 4.3 % of the samples are missing, the longest gap 10 rows (0.2 s), lines 202 to",
    ),
    "part of a position": (lambda: moved(lambda p: p.__setitem__((40, 1, 2), np.nan)), "warning", "s2", "line 42: part of the position is"),
    "only noise": (lambda: moved(cold), "error", "s2", "stands still"),
    "on its side": (lambda: moved(sideways), "error", "s1", "not above the base at the start"),
    "slow tracker": (lambda: moved(twice), "warning", "", "every pose stands 2 times"),
    "too far": (lambda: moved(lambda p: p.__iadd__([0, 0, 0.3])), "warning", "s1", "typically 4.12 times as far from the base as at rest"),
    "saturated": (
        lambda: changed(inputs=np.where(np.arange(12) == 4, 5e5, STEPS.inputs)),
        *("warning", "pressure_22_Pa", "lines 2 to 301: saturated: at its limit of 500000 Pa in 100 % of the run"),
    ),
    "no excitation": (lambda: changed(inputs=np.tile(STEPS.inputs[0], (300, 1))), "warning", "", "nothing is excited"),
    "starts at once": (lambda: changed(**of_steps(lambda a: a[48:])), "warning", "", "line 2: inputs move at once"),
    "irregular": (lambda: changed(time=uneven()), "warning", "time_s", "rows are irregular"),
    "a lost row": (
        lambda: changed(**of_steps(lambda a: np.delete(a, 30, axis=0))),
        *("warning", "time_s", "line 32: 1 rows are missing in 1 gaps, the longest 0.04 s before line 32"),
    ),
    "a slightly other rate": (
        lambda: changed(time=np.arange(300) * 0.0205),
        "warning",
        "time_s",
        "rows come at 48.78 Hz, sample_rate_hz =",
    ),
    "measured value frozen": (lambda: changed(extra={BUSY: np.full(300, 0.7)}), "error", BUSY, "frozen: one value in all rows"),
    "measured in kPa": (
        lambda: changed(extra=in_kilopascal()),
        "error",
        "pressure_",
        "moves 0.001 times as much as its command: another unit?",
    ),
    "nothing measured": (lambda: changed(extra={BUSY: np.full(300, np.nan)}), "error", BUSY, "empty in all rows"),
}


@pytest.mark.parametrize("name", DOUBTS)
def test_doubts(name: str) -> None:
    make, severity, channel, message = DOUBTS[name]
    findings = [finding for finding in check_dataset(make()) if finding.file == "steps.csv"]
    assert message in findings[0].message
    assert (findings[0].severity, findings[0].channel[: len(channel)]) == (severity, channel)
    assert len(findings) == 1 or name in {"on its side", "too far", "slow tracker", "measured in kPa", "a slightly other rate"}, findings


class TestTogether:
    def test_nothing_to_fit_to(self) -> None:
        dataset = replace(make_dataset(), channels=CHANNELS)
        still = replace(dataset.runs[0], inputs=np.tile(dataset.runs[0].inputs[0], (300, 1)))
        found = check_dataset(replace(dataset, runs=(still, dataset.runs[1])))
        assert any("nothing can be learnt" in finding.message for finding in errors(found))

    def test_roles(self) -> None:
        dataset = make_dataset()
        assert [f.message for f in check_dataset(replace(dataset, runs=dataset.runs[:1]))] == ["no run has the role 'validation'"]
        assert [f.message for f in check_dataset(replace(dataset, runs=()))] == ["lists no runs"]

    def test_declared_noise(self) -> None:
        found = check_dataset(replace(make_dataset(), position_noise=3e-5))
        assert ["position_noise_m = 3e-05, but the samples scatter by 3" in f.message for f in found] == [True]

    def test_a_file_that_is_not_listed(self, tmp_path: Path) -> None:
        write_dataset(make_dataset(), tmp_path)
        (tmp_path / "more.csv").write_text("x\n1\n")
        (tmp_path / ".steps.abcdefgh.csv").write_text("x\n1\n")
        assert [(f.severity, f.file, f.message) for f in check(tmp_path)] == [
            ("warning", "more.csv", "in the folder, but not listed in dataset.toml")
        ]

    def test_all_faults_not_the_first(self, tmp_path: Path) -> None:
        write_dataset(make_dataset(), tmp_path)
        text = (tmp_path / "dataset.toml").read_text().replace('"fit"', '"fitt"').replace("name =", "nam =")
        (tmp_path / "dataset.toml").write_text(text)
        messages = [finding.message for finding in errors(check(tmp_path))]
        assert len(messages) == 3
        assert all(any(part in message for message in messages) for part in ("'name'", "'nam'", "'fitt'"))
        write_dataset(make_dataset(), tmp_path, overwrite=True)
        (tmp_path / "other.csv").unlink()
        (tmp_path / "steps.csv").write_text("time_s\n0\n")
        assert [finding.file for finding in errors(check(tmp_path))] == ["steps.csv", "other.csv"]


class TestEquilibria:
    def static(self) -> DataSet:
        steps = make_dataset().runs[0]
        rows = slice(None, None, 10)
        run = Run("static.csv", "fit", np.full(30, np.nan), steps.inputs[rows], steps.tip_force[rows], steps.points[rows])
        return DataSet(
            "static", "kang2017", CHANNELS, (run, replace(run, file="b.csv", role="validation", points=run.points + 1e-4)), static=True
        )

    def test_silence(self) -> None:
        assert check_dataset(self.static()) == []

    def test_faults(self) -> None:
        dataset = self.static()
        run = dataset.runs[0]
        swapped = replace(run, points=run.points[:, [0, 1, 3, 2]])
        assert [f.channel for f in check_dataset(replace(dataset, runs=(swapped, dataset.runs[1])))] == ["s3 s4"]
        again = {name: np.concatenate([getattr(run, name), getattr(run, name)[:2]]) for name in ("time", "inputs", "tip_force", "points")}
        found = check_dataset(replace(dataset, runs=(replace(run, **again), dataset.runs[1])))
        assert [f.message for f in found] == ["lines 32, 33: stands in the file before"]


class TestCommandLine:
    def test_clean(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        write_dataset(make_dataset(), tmp_path)
        assert tepm(["data", "check", str(tmp_path)]) == 0
        assert "nothing to complain of" in capsys.readouterr().out

    def test_a_table(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        write_dataset(moved(lambda p: p[40::8, 2].__iadd__(0.08)), tmp_path)
        assert tepm(["data", "check", str(tmp_path)]) == 1
        shown = capsys.readouterr().out
        assert "1 errors, 0 warnings" in shown
        assert "spikes" in shown
        assert "s3" in shown

    def test_warnings_are_no_failure(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        write_dataset(moved(gone), tmp_path)
        assert tepm(["data", "check", str(tmp_path), "--json"]) == 0
        assert '"warnings": 1' in capsys.readouterr().out

    def test_not_there(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert tepm(["data", "check", str(tmp_path / "none")]) == 2
        assert "is not a folder" in capsys.readouterr().err


def test_a_robot_of_another_size(tmp_path: Path) -> None:
    """Nothing is tied to kang2017: with its own columns and no robot a set is judged as far as that goes."""
    dataset = make_dataset()
    one = tuple(replace(run, inputs=run.inputs[:, [0, 1, 2, 6, 7, 8]], points=run.points[:, :2]) for run in dataset.runs)
    small = replace(dataset, channels=replace(NAMES, actuators=NAMES.actuators[:3], points=NAMES.points[:2]), runs=one)
    write_dataset(small, tmp_path)
    assert check_reading(read_folder(tmp_path)) == []
    assert read_dataset(tmp_path).runs[0].points.shape == (300, 2, 3)


def test_no_points_at_all() -> None:
    """The bench of a single actuator measures lengths only."""
    dataset = make_dataset()
    runs = tuple(replace(run, points=np.empty((300, 0, 3)), extra={"length_11_m": np.full(300, 0.2)}) for run in dataset.runs)
    assert check_dataset(replace(dataset, channels=replace(NAMES, points=()), runs=runs, position_noise=None)) == []
