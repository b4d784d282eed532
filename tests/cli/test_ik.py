"""`tepm ik`: files, modes, trajectories, targets out of reach, robots, models, interruption."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from tepm_opt import ActuationMode
from tepm_opt.jobs import ik as job
from tests.cli.conftest import PNG, Command
from tests.cli.tables import (
    IK_FILES,
    TABLES,
    circle,
    input_columns,
    length_columns,
    names_in,
    shape_columns,
    summary,
    table,
    tips,
    values,
    write_rows,
)

LENGTHS_ALIKE = 1e-7  # m
TARGET_MET = 1e-6  # m
ROUNDED_MISS = 5e-5  # m, hybrid
PRESSURE_STEP, TENSION_STEP = 4500.0, 1.05e-3  # Pa, N: SPEC section 1


def distances(tips: np.ndarray, targets: np.ndarray) -> np.ndarray:
    return np.linalg.norm(tips - targets, axis=1)


@pytest.fixture
def interrupted_after(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Lets a person press Ctrl-C once, while the point after the first `count` is solved."""

    def install(count: int) -> None:
        solve, pressed = job.each_configuration, []

        def each(*arguments: Any, **options: Any) -> Iterator[Any]:
            for number, found in enumerate(solve(*arguments, **options)):
                if number == count and not pressed:
                    pressed.append(number)
                    raise KeyboardInterrupt
                yield found

        monkeypatch.setattr(job, "each_configuration", each)

    return install


class TestCircle:
    def test_files_and_columns(self, solved_circle: Path) -> None:
        assert names_in(solved_circle) == IK_FILES | {"gain.csv", "gain.png"}
        for name, header in {
            "inputs.csv": input_columns(),
            "inputs_rounded.csv": input_columns(),
            "shape.csv": shape_columns(),
            "lengths.csv": length_columns(),
        }.items():
            found, rows = table(solved_circle / name)
            assert found == header
            assert rows.shape == (32, len(header))
            np.testing.assert_array_equal(rows[:, 0], np.arange(32) / 4)  # 8 s over 32 points
        assert (solved_circle / "ik.png").read_bytes().startswith(PNG)

    def test_numbers(self, solved_circle: Path) -> None:
        assert distances(tips(solved_circle), circle(32)).max() <= TARGET_MET
        lengths = values(solved_circle / "lengths.csv")[:, 1:]
        assert np.abs(lengths[:, :3] - lengths[:, 3:]).max() <= LENGTHS_ALIKE
        inputs = values(solved_circle / "inputs.csv")[:, 1:]
        assert inputs[:, :6].min() >= 0
        assert inputs[:, :6].max() <= 0.5e6
        assert np.abs(inputs[:, :6] / PRESSURE_STEP - np.round(inputs[:, :6] / PRESSURE_STEP)).max() <= 1e-9
        # half a pressure step is 0.113 N: what tension has to take about its middle of 3.5 N
        assert np.abs(inputs[:, 6:] - 3.5).max() <= 0.5 * PRESSURE_STEP * 50.27e-6 + 1e-9

    def test_rounded_inputs_are_on_the_grids_and_near(self, solved_circle: Path) -> None:
        exact, rounded = (values(solved_circle / name)[:, 1:] for name in ("inputs.csv", "inputs_rounded.csv"))
        steps = np.repeat([PRESSURE_STEP, TENSION_STEP], 6)
        assert np.abs(rounded / steps - np.round(rounded / steps)).max() <= 1e-9
        assert (np.abs(rounded - exact) <= 0.5 * steps * (1 + 1e-9)).all()

    @pytest.mark.slow
    def test_statics_of_the_files_lands_on_the_targets(self, tepm: Command, here: Path, solved_circle: Path) -> None:
        for name, largest in (("inputs.csv", TARGET_MET), ("inputs_rounded.csv", ROUNDED_MISS)):
            assert tepm("statics", solved_circle / name, "--out", name).status == 0
            assert distances(tips(here / name), circle(32)).max() <= largest
        lengths = values(here / "inputs.csv" / "lengths.csv")[:, 1:]
        assert np.abs(lengths[:, :3] - lengths[:, 3:]).max() <= LENGTHS_ALIKE

    def test_summary_agrees_with_the_files(self, tepm: Command, here: Path, solved_circle: Path) -> None:
        told = summary(solved_circle, "ik")
        expected = {"robot": "kang2017", "mode": "hybrid", "points": 32, "solved": 32, "interrupted": False, "unsolved": []}
        assert {key: told[key] for key in expected} == expected
        assert told["largest_tip_error_m"] == distances(tips(solved_circle), circle(32)).max()
        assert tepm("statics", solved_circle / "inputs_rounded.csv", "--out", "rounded").status == 0
        misses = distances(tips(here / "rounded"), circle(32))
        assert told["largest_rounded_tip_error_m"] == pytest.approx(misses.max(), abs=1e-9)
        assert told["rounded_tip_error_rms_m"] == pytest.approx(np.sqrt(np.mean(misses**2)), abs=1e-9)

    @pytest.mark.slow
    def test_pressure_mode_and_what_rounding_costs(self, tepm: Command, here: Path) -> None:
        done = tepm("ik", "circle", "--out", "out", "--mode", "pressure")
        assert (done.status, done.err) == (0, "")
        assert "32 of 32" in done.out
        assert names_in(here / "out") == IK_FILES
        header, inputs = table(here / "out" / "inputs.csv")
        assert header == input_columns()
        assert (inputs[:, 7:] == 0).all()
        assert distances(tips(here / "out"), circle(32)).max() <= TARGET_MET
        told = summary(here / "out", "ik")
        assert told["mode"] == "pressure"
        # the paper's point: pressure alone misses by millimetres, with tension by hundredths (see the hybrid tests)
        assert 1e-3 < told["largest_rounded_tip_error_m"] < 1.5e-2

    @pytest.mark.slow
    def test_options(self, tepm: Command, here: Path) -> None:
        done = tepm("ik", "circle", "--points", 5, "--radius", 0.1, "--height", 0.36, "--duration", 2, "--mid-tension", 2, "--out", "out")
        assert done.status == 0
        assert distances(tips(here / "out"), circle(5, 0.1, 0.36)).max() <= TARGET_MET
        inputs = values(here / "out" / "inputs.csv")
        np.testing.assert_allclose(inputs[:, 0], [0, 0.4, 0.8, 1.2, 1.6], rtol=1e-12)
        assert np.abs(inputs[:, 7:] - 2).max() <= 0.5 * PRESSURE_STEP * 50.27e-6 + 1e-9

    @pytest.mark.slow
    def test_tip_force_is_held_against(self, tepm: Command, here: Path) -> None:
        assert tepm("ik", "circle", "--points", 3, "--tip-force", "0.3,-0.2,0.1", "--out", "out").status == 0
        header, inputs = table(here / "out" / "inputs.csv")
        assert header == [*input_columns(), "tip_force_x_N", "tip_force_y_N", "tip_force_z_N"]
        np.testing.assert_array_equal(inputs[:, 13:], np.tile([0.3, -0.2, 0.1], (3, 1)))
        assert tepm("statics", "out/inputs.csv", "--out", "again").status == 0
        assert distances(tips(here / "again"), circle(3)).max() <= TARGET_MET

    @pytest.mark.slow
    def test_default_folder_is_named(self, tepm: Command, here: Path) -> None:
        done = tepm("ik", "circle", "--points", 2)
        assert "files in ik" in done.out
        assert names_in(here / "ik") == IK_FILES


class TestTrajectories:
    @pytest.mark.slow
    def test_line(self, tepm: Command, here: Path) -> None:
        assert tepm("ik", "line", "--from", "-0.1,0,0.36", "--to", "0.1,0.05,0.34", "--points", 4, "--out", "out").status == 0
        expected = np.linspace([-0.1, 0, 0.36], [0.1, 0.05, 0.34], 4)
        assert distances(tips(here / "out"), expected).max() <= TARGET_MET

    @pytest.mark.slow
    def test_lissajous(self, tepm: Command, here: Path) -> None:
        assert tepm("ik", "lissajous", "--points", 8, "--radius", 0.1, "--out", "out").status == 0
        w = 2 * np.pi * np.arange(8) / 8
        expected = np.stack([0.1 * np.sin(w), 0.1 * np.sin(2 * w), np.full(8, 0.35)], axis=1)
        assert distances(tips(here / "out"), expected).max() <= TARGET_MET

    @pytest.mark.slow
    @pytest.mark.parametrize("header", [["time_s", "x", "y", "z"], ["t", "x_m", "y_m", "z_m"], ["z", "time", "note", "y", "x"]])
    def test_file_with_time(self, tepm: Command, here: Path, header: list[str]) -> None:
        time, targets = np.array([1.0, 1.5, 4.0]), circle(9)[:3]
        columns = {"x": targets[:, 0], "y": targets[:, 1], "z": targets[:, 2], "t": time, "time": time, "n": np.arange(3)}
        rows = np.stack([columns.get(name) if name in columns else columns[name[0]] for name in header], axis=1)
        write_rows(here / "mine.csv", header, rows)
        assert tepm("ik", "mine.csv", "--out", "out").status == 0
        for name in TABLES:
            np.testing.assert_array_equal(values(here / "out" / name)[:, 0], time)
        assert distances(tips(here / "out"), targets).max() <= TARGET_MET

    @pytest.mark.slow
    @pytest.mark.parametrize(("options", "time"), [((), [0, 4, 8]), (("--duration", 3), [0, 1.5, 3])])
    def test_file_without_time(self, tepm: Command, here: Path, options: tuple[object, ...], time: list[float]) -> None:
        write_rows(here / "mine.csv", ["x", "y", "z"], circle(9)[:3])
        assert tepm("ik", "mine.csv", *options, "--out", "out").status == 0
        np.testing.assert_allclose(values(here / "out" / "inputs.csv")[:, 0], time, atol=1e-12)
        assert distances(tips(here / "out"), circle(9)[:3]).max() <= TARGET_MET

    @pytest.mark.slow
    def test_file_of_a_spreadsheet(self, tepm: Command, here: Path) -> None:
        """Byte order mark, Windows line ends, blanks around names, an empty last line."""
        (here / "mine.csv").write_bytes(b"\xef\xbb\xbfx, y, z\r\n0.1,0,0.35\r\n0.11,0,0.36\r\n\r\n")
        assert tepm("ik", "mine.csv", "--out", "out").status == 0
        assert distances(tips(here / "out"), np.array([[0.1, 0, 0.35], [0.11, 0, 0.36]])).max() <= TARGET_MET

    @pytest.mark.slow
    def test_resampled_by_pchip(self, tepm: Command, here: Path) -> None:
        time, targets = np.array([0.0, 1.0, 3.0, 4.0]), circle(12)[:4]
        write_rows(here / "mine.csv", ["t", "x", "y", "z"], np.column_stack([time, targets]))
        assert tepm("ik", "mine.csv", "--points", 7, "--out", "out").status == 0
        at = np.linspace(0, 4, 7)
        np.testing.assert_allclose(values(here / "out" / "inputs.csv")[:, 0], at, atol=1e-12)
        assert distances(tips(here / "out"), PchipInterpolator(time, targets)(at)).max() <= TARGET_MET


class TestOutOfReach:
    TARGETS = np.linspace([-0.15, 0, 0.35], [0.5, 0, 0.35], 6)

    @pytest.mark.slow
    @pytest.mark.usefixtures("drawn")
    @pytest.mark.parametrize("mode", ["hybrid", "pressure"])
    def test_rest_is_solved_and_the_miss_explained(self, tepm: Command, here: Path, mode: str) -> None:
        done = tepm("ik", "line", "--from", "-0.15,0,0.35", "--to", "0.5,0,0.35", "--points", 6, "--mode", mode, "--out", "out")
        assert done.status == 1
        assert done.err == ""
        told = summary(here / "out", "ik")
        unsolved = [entry["point"] for entry in told["unsolved"]]
        solved = [k for k in range(6) if k not in unsolved]
        assert told["solved"] == len(solved)
        assert solved[:3] == [0, 1, 2]
        assert unsolved[-2:] == [4, 5]
        reached = tips(here / "out")
        assert distances(reached[solved], self.TARGETS[solved]).max() <= TARGET_MET
        for entry in told["unsolved"]:
            miss = np.linalg.norm(reached[entry["point"]] - self.TARGETS[entry["point"]])
            assert entry["status"] == "out of reach"
            assert entry["miss_m"] == pytest.approx(miss, abs=TARGET_MET)
            assert entry["miss_m"] > 1e-3
            assert entry["limits"]
            assert all(limit in entry["message"] for limit in entry["limits"])
            assert f"{1e3 * entry['miss_m']:.2f} mm" in entry["message"]
            assert f"point {entry['point'] + 1}: " in done.out

    @pytest.mark.slow
    def test_rows_of_nearest_points_are_written_and_read_back(self, tepm: Command, here: Path) -> None:
        tepm("ik", "line", "--from", "-0.15,0,0.35", "--to", "0.5,0,0.35", "--points", 6, "--out", "out")
        for name in TABLES:
            rows = values(here / "out" / name)
            assert len(rows) == 6
            assert np.isfinite(rows).all()
        lengths = values(here / "out" / "lengths.csv")[:, 1:]
        assert np.abs(lengths[:, :3] - lengths[:, 3:]).max() <= LENGTHS_ALIKE
        inputs = values(here / "out" / "inputs.csv")[:, 1:]
        assert (inputs >= 0).all()
        assert (inputs <= np.repeat([0.5e6, 7.0], 6)).all()
        assert tepm("statics", "out/inputs.csv", "--out", "again").status == 0
        np.testing.assert_allclose(tips(here / "again"), tips(here / "out"), atol=TARGET_MET)
        assert tepm("gain", "out/inputs.csv", "--out", "out").status == 0

    @pytest.mark.slow
    @pytest.mark.usefixtures("drawn")
    def test_all_out_of_reach_is_no_success(self, tepm: Command, here: Path) -> None:
        done = tepm("ik", "circle", "--points", 2, "--radius", 0.6, "--out", "out")
        assert done.status == 1
        assert done.out.startswith("0 of 2")
        assert names_in(here / "out") == IK_FILES
        told = summary(here / "out", "ik")
        assert (told["solved"], told["rounded_tip_error_rms_m"]) == (0, None)

    @pytest.mark.slow
    def test_no_error_is_told_where_nothing_was_solved(self, tepm: Command, here: Path) -> None:
        tepm("ik", "circle", "--points", 1, "--radius", 0.6, "--out", "out")
        told = summary(here / "out", "ik")
        assert told["largest_tip_error_m"] is None
        assert told["largest_length_difference_m"] is None
        assert told["largest_rounded_tip_error_m"] is None


class TestInterruption:
    @pytest.mark.slow
    def test_points_so_far_are_kept(self, tepm: Command, here: Path, interrupted_after: Callable[[int], None]) -> None:
        interrupted_after(3)
        done = tepm("ik", "circle", "--out", "out")
        assert done.status == 130
        assert "Traceback" not in done.err
        assert names_in(here / "out") == IK_FILES
        for name in TABLES:
            assert len(values(here / "out" / name)) == 3
        assert distances(tips(here / "out"), circle(32)[:3]).max() <= TARGET_MET
        told = summary(here / "out", "ik")
        assert told["interrupted"] is True
        assert (told["points"], told["solved"]) == (32, 3)

    def test_before_the_first_point(self, tepm: Command, here: Path, interrupted_after: Callable[[int], None]) -> None:
        interrupted_after(0)
        assert tepm("ik", "circle", "--out", "out").status == 130
        assert names_in(here / "out") == set()

    @pytest.mark.slow
    def test_json(self, tepm: Command, interrupted_after: Callable[[int], None]) -> None:
        interrupted_after(2)
        done = tepm("ik", "circle", "--out", "out", "--json")
        assert done.status == 130
        assert done.json()["interrupted"] is True

    @pytest.mark.usefixtures("quick")
    def test_demo_stops_in_its_first_part(self, tepm: Command, interrupted_after: Callable[[int], None]) -> None:
        interrupted_after(2)
        done = tepm("demo", "--out", "out")
        assert done.status == 130
        assert "Traceback" not in done.err

    @pytest.mark.usefixtures("quick", "drawn")
    def test_demo_stops_before_the_first_set_point(self, tepm: Command, monkeypatch: pytest.MonkeyPatch) -> None:
        solve = job.each_configuration

        def each(*arguments: Any, **options: Any) -> Iterator[Any]:
            if any(argument is ActuationMode.HYBRID for argument in arguments):
                raise KeyboardInterrupt
            yield from solve(*arguments, **options)

        monkeypatch.setattr(job, "each_configuration", each)
        assert tepm("demo", "--out", "out").status == 130


class TestRobots:
    """A robot of one's own: `robot new`, edited text, `ik`, `gain`."""

    CASES = (
        pytest.param(
            {"modules = 2": "modules = 1", "module = 6": "module = 12"},
            (1, 3),
            ("circle", "--radius", 0.04, "--height", 0.17),
            circle(4, 0.04, 0.17),
            id="one module of 12 segments",
            marks=pytest.mark.slow,
        ),
        pytest.param(  # hanging from a base that is turned over and shifted: upright, three modules buckle under their weight
            {"modules = 2": "modules = 3", "module = 6": "module = 2", "[0, 0, -0.050]": "[0.1, 0, 0.9]", "[0, 0, 0]  ": "[180, 0, 0]"},
            (3, 3),
            ("line", "--from", "0.10,0,0.275", "--to", "0.15,0.03,0.270"),
            np.linspace([0.1, 0, 0.275], [0.15, 0.03, 0.27], 4),
            id="three modules of 2 segments",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            {"[90, 210, 330]": "[0, 90, 180, 270]", "module = 6": "module = 5"},
            (2, 4),
            ("circle", "--radius", 0.1, "--height", 0.37),
            circle(4, 0.1, 0.37),
            id="four actuators and 5 segments",
        ),
    )

    @pytest.mark.slow
    @pytest.mark.parametrize(("changes", "size", "trajectory", "targets"), CASES)
    def test_own_robot(
        self, tepm: Command, here: Path, changes: dict[str, str], size: tuple[int, int], trajectory: tuple[object, ...], targets: np.ndarray
    ) -> None:
        assert tepm("robot", "new", "mine.toml").status == 0
        text = (here / "mine.toml").read_text()
        for old, new in changes.items():
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (here / "mine.toml").write_text(text)
        checked = tepm("robot", "check", "mine.toml", "--json").json()
        assert (checked["robot"], checked["modules"], checked["actuators"]) == ("mine", *size)

        for mode in ("pressure", "hybrid"):
            done = tepm("ik", *trajectory, "--points", 4, "--robot", "mine.toml", "--mode", mode, "--out", mode)
            assert done.status == 0, done.out
        modules, actuators = size
        assert table(here / "hybrid" / "inputs.csv")[0] == input_columns(*size)
        assert table(here / "hybrid" / "shape.csv")[0] == shape_columns(2 * modules)
        header, lengths = table(here / "hybrid" / "lengths.csv")
        assert header == length_columns(*size)
        by_module = lengths[:, 1:].reshape(4, modules, actuators)
        assert np.ptp(by_module, axis=1).max() <= LENGTHS_ALIKE
        assert distances(tips(here / "hybrid"), targets).max() <= TARGET_MET
        assert summary(here / "hybrid", "ik")["largest_rounded_tip_error_m"] <= ROUNDED_MISS

        assert tepm("gain", "hybrid/inputs.csv", "--robot", "mine.toml", "--out", "gain").status == 0
        header, gains = table(here / "gain" / "gain.csv")
        assert header == [f"g_{row}_{k}" for row in (1, 2, 3) for k in range(1, 2 * modules * actuators + 1)]
        # Eq. (3): one newton of tension undoes one newton of pressure
        matrices = gains.reshape(4, 3, 2, modules * actuators)
        np.testing.assert_allclose(matrices[:, :, 0], -50.27e-6 * matrices[:, :, 1], rtol=1e-9, atol=1e-15)


class TestModels:
    @pytest.mark.slow
    def test_payload_and_dead_zone(self, tepm: Command, here: Path) -> None:
        (here / "m.toml").write_text(
            'robot = "kang2017"\n\n[[effects]]\nname = "payload"\nparameters = {mass = 0.02}\n\n'
            '[[effects]]\nname = "pressure_dead_zone"\nparameters = {threshold = 8e3}\n'
        )
        weight = f"0,0,{-0.02 * 9.81!r}"
        for mode in ("pressure", "hybrid"):
            assert tepm("ik", "circle", "--points", 4, "--model", "m.toml", "--mode", mode, "--out", mode).status == 0
            assert distances(tips(here / mode), circle(4)).max() <= TARGET_MET
        # far above the threshold the dead zone takes 8 kPa, and a mass at the tip is its weight there
        assert tepm("ik", "circle", "--points", 4, "--tip-force", weight, "--mode", "pressure", "--out", "nominal").status == 0
        with_effects, nominal = (values(here / name / "inputs.csv")[:, 1:13] for name in ("pressure", "nominal"))
        np.testing.assert_allclose(with_effects[:, :6], nominal[:, :6] + 8e3, atol=0.1)
        grid = values(here / "hybrid" / "inputs.csv")[:, 1:7] / PRESSURE_STEP
        assert np.abs(grid - np.round(grid)).max() <= 1e-9
        assert summary(here / "hybrid", "ik")["largest_rounded_tip_error_m"] <= ROUNDED_MISS

        assert tepm("gain", "pressure/inputs.csv", "--model", "m.toml", "--out", "pressure").status == 0
        assert tepm("gain", "nominal/inputs.csv", "--out", "nominal").status == 0
        gains = [values(here / name / "gain.csv") for name in ("pressure", "nominal")]
        assert np.abs(gains[0] - gains[1]).max() <= 1e-6 * np.abs(gains[1]).max()

        assert tepm("statics", "hybrid/inputs.csv", "--model", "m.toml", "--out", "again").status == 0
        assert distances(tips(here / "again"), circle(4)).max() <= TARGET_MET
        assert tepm("statics", "hybrid/inputs.csv", "--out", "without").status == 0
        assert distances(tips(here / "without"), circle(4)).min() > 1e-3, "the effects must be felt"

    def test_parameters_of_a_model_file(self, tepm: Command, here: Path) -> None:
        (here / "m.toml").write_text('robot = "kang2017"\n\n[parameters]\nK_a = 350.0\n')
        (here / "r.toml").write_text(tepm_robot_text(tepm, here).replace("K_a = 358.86", "K_a = 350.0", 1))
        by_model = tepm("statics", "--model", "m.toml", "--json").json()
        by_robot = tepm("statics", "--robot", "r.toml", "--json").json()
        assert by_model["tip_m"] == by_robot["tip_m"]
        assert by_model["tip_m"] != tepm("statics", "--json").json()["tip_m"]

    def test_robot_beside_the_model_file(self, tepm: Command, here: Path) -> None:
        """A path in a model file is relative to the file."""
        (here / "lab").mkdir()
        assert tepm("robot", "new", "lab/arm.toml").status == 0
        (here / "lab" / "m.toml").write_text('robot = "arm.toml"\n')
        done = tepm("statics", "--model", "lab/m.toml", "--json").json()
        assert done["robot"] == "arm"
        assert done["tip_m"] == tepm("statics", "--json").json()["tip_m"]


def tepm_robot_text(tepm: Command, here: Path) -> str:
    assert tepm("robot", "new", "new.toml").status == 0
    return (here / "new.toml").read_text()
