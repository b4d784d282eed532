"""Where the tip shall go."""

import numpy as np
import pytest

from tepm_opt.data.tables import write_table
from tepm_opt.errors import InputError
from tepm_opt.solvers.planning.trajectories import circle, line, lissajous, read_trajectory


def test_the_papers_circle():
    """Eq. (7) and SPEC section 3: x = 150 cos w, y = 150 sin w, z = 350 mm, 32 points w = 2 pi k / 32 from k = 0."""
    path = circle()
    assert path.positions.shape == (32, 3)
    assert path.closed
    np.testing.assert_allclose(path.positions[0], [0.15, 0, 0.35])
    np.testing.assert_allclose(path.positions[8], [0, 0.15, 0.35], atol=1e-15)
    np.testing.assert_allclose(np.hypot(*path.positions[:, :2].T), 0.15)
    steps = np.linalg.norm(np.diff(path.positions, axis=0, append=path.positions[:1]), axis=1)
    np.testing.assert_allclose(steps, 0.3 * np.sin(np.pi / 32))  # also from the last to the first
    np.testing.assert_allclose(np.diff(path.time), 8 / 32)


def test_figure_of_eight():
    path = lissajous(64)
    np.testing.assert_allclose(path.positions[[0, 32]], [[0, 0, 0.35]] * 2, atol=1e-15)
    np.testing.assert_allclose(path.positions[16], [0.12, 0, 0.35], atol=1e-15)
    assert path.positions[8, 1] == pytest.approx(0.12)
    assert path.closed


def test_line():
    path = line(5, 4.0, (0, 0, 0.3), (0.1, 0.2, 0.4))
    np.testing.assert_allclose(path.positions[[0, 2, 4]], [[0, 0, 0.3], [0.05, 0.1, 0.35], [0.1, 0.2, 0.4]])
    np.testing.assert_allclose(path.time, [0, 1, 2, 3, 4])
    assert not path.closed


@pytest.mark.parametrize("path", [circle, lissajous])
def test_closed_paths_are_moved_and_scaled(path):
    """By radius, height and duration."""
    one, other = path(16), path(16, duration=3.0, radius=0.1, height=0.3)
    largest = np.abs(one.positions[:, :2]).max()
    np.testing.assert_allclose(other.positions[:, :2], 0.1 / largest * one.positions[:, :2], atol=1e-15)
    assert set(other.positions[:, 2]) == {0.3}
    np.testing.assert_allclose(other.time, 3.0 * np.arange(16) / 16)


@pytest.mark.parametrize("path", [circle, lissajous, line])
@pytest.mark.parametrize("points", [0, -3, 10**9])
def test_absurd_numbers_of_points_are_refused(path, points):
    with pytest.raises(InputError, match=f"points = {points}; valid: 1 … 100000"):
        path(points)


def test_resampling_keeps_the_points_and_the_path():
    path = line(5)
    finer = path.resample(9)
    np.testing.assert_allclose(finer.positions[::2], path.positions, atol=1e-15)
    np.testing.assert_allclose(finer.positions[1::2], (path.positions[1:] + path.positions[:-1]) / 2, atol=1e-12)
    np.testing.assert_allclose(circle(65).resample(130).positions[::2], circle(65).positions, atol=1e-12)
    with pytest.raises(InputError, match="points = 0"):
        path.resample(0)
    with pytest.raises(InputError, match="at least 2 points"):
        circle(1).resample(5)


@pytest.mark.parametrize("names", [("time_s", "x_m", "y_m", "z_m"), ("t", "x", "y", "z"), ("time", "x_m", "y", "z_m")])
def test_files(tmp_path, names):
    path = tmp_path / "path.csv"
    rows = np.array([[0, 0.1, 0.2, 0.3], [2, 0.2, 0.3, 0.4], [3, 0.3, 0.4, 0.5]])
    write_table(path, names, rows)
    found = read_trajectory(path)
    np.testing.assert_array_equal(np.column_stack([found.time, found.positions]), rows)
    assert not found.closed


def test_a_file_without_time_is_spread_over_the_duration(tmp_path):
    write_table(tmp_path / "path.csv", ["x", "y", "z"], np.ones((5, 3)))
    np.testing.assert_array_equal(read_trajectory(tmp_path / "path.csv").time, [0, 2, 4, 6, 8])
    np.testing.assert_array_equal(read_trajectory(tmp_path / "path.csv", 6.0).time, [0, 1.5, 3, 4.5, 6])
    write_table(tmp_path / "timed.csv", ["t", "x", "y", "z"], np.array([[0, 1, 1, 1], [1, 1, 1, 1]]))
    with pytest.raises(InputError, match="has a column 't', so a duration does not fit"):
        read_trajectory(tmp_path / "timed.csv", 6.0)


@pytest.mark.parametrize(
    ("names", "row", "message"),
    [
        (("x", "y"), (1, 2), "column 'z_?m?' is missing; found: x, y"),
        (("x", "y", "z"), (0.1, 0.2, np.nan), "line 2: z is empty; valid: a finite number"),
        (("x", "y", "z"), (150, 0, 350), "line 2: x = 150; valid: metres within 50 m, not millimetres"),
    ],
)
def test_malformed_files(tmp_path, names, row, message):
    write_table(tmp_path / "path.csv", names, np.array([row]))
    with pytest.raises(InputError, match=message):
        read_trajectory(tmp_path / "path.csv")
