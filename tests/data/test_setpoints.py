"""Set-point files: SPEC section 4's columns, in its order, within the robot's limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tepm_opt.data.setpoints import SetPoints, gain_columns, input_columns, length_columns, point_columns, read_setpoints, write_setpoints
from tepm_opt.data.tables import read_table, write_table
from tepm_opt.errors import InputError
from tests.paths import reference

ACTUATORS = ("11", "12")
LIMITS = np.array([5e5, 5e5, 7.0, 7.0])
HEADER = ["time_s", "pressure_11_Pa", "pressure_12_Pa", "tension_11_N", "tension_12_N"]


@given(
    arrays(float, (4, 4), elements=st.floats(0, 1)),
    arrays(float, (4, 3), elements=st.one_of(st.just(0.0), st.floats(-5, 5))),
    st.lists(st.floats(0, 1e4), min_size=4, max_size=4, unique=True),
)
def test_round_trip_is_exact(tmp_path_factory, parts, forces, times):
    path = tmp_path_factory.mktemp("setpoints") / "inputs.csv"
    parts[-1] = 1.0  # a table of tiny values is taken for one in another unit
    written = SetPoints(np.sort(times), parts * LIMITS, forces)
    write_setpoints(path, written, ACTUATORS)
    back = read_setpoints(path, ACTUATORS, LIMITS)
    for name in ("time", "inputs", "tip_force"):
        np.testing.assert_array_equal(getattr(back, name), getattr(written, name))
    assert ("tip_force_x_N" in read_table(path)) == bool(forces.any())


def test_columns_are_those_of_the_specification():
    names = [f"{h}{j}" for h in (1, 2) for j in (1, 2, 3)]
    header = reference("null/circle.csv").read_text().split("\n", 1)[0].split(",")
    assert header[1:13] == input_columns(names)
    assert header[16:] == point_columns(["s1", "s2", "s3", "s4"])
    static = reference("static.csv").read_text().split("\n", 1)[0].split(",")
    assert static[-7:-1] == length_columns(names)
    columns = gain_columns(12)
    assert columns[2 * 12 + 2] == "g_3_3"
    assert columns[2 * 12 + 8] == "g_3_9"
    assert len(columns) == 36


def write(tmp_path, names, *rows):
    path = tmp_path / "inputs.csv"
    write_table(path, names, np.array(rows))
    return path


def test_order_of_columns_is_free_and_others_are_ignored(tmp_path):
    path = write(tmp_path, [*reversed(HEADER), "note"], [4, 3, 2e5, 1e5, 0, 9], [7, 7, 4e5, 3e5, 1, 9])
    found = read_setpoints(path, ACTUATORS, LIMITS)
    np.testing.assert_array_equal(found.time, [0, 1])
    np.testing.assert_array_equal(found.inputs, [[1e5, 2e5, 3, 4], [3e5, 4e5, 7, 7]])
    assert not found.tip_force.any()


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        (1, 5.1e5, "line 3: pressure_11_Pa = 510000; valid: 0 … 500000 Pa"),
        (2, -1.0, "line 3: pressure_12_Pa = -1; valid: 0 … 500000 Pa"),
        (4, 7.01, "line 3: tension_12_N = 7.01; valid: 0 … 7 N"),
        (3, np.nan, "line 3: tension_11_N is empty; valid: a finite number"),
        (0, 0.0, "line 3: time_s = 0; valid: larger than in the row before"),
    ],
)
def test_wrong_values(tmp_path, column, value, message):
    row = np.array([1.0, 1, 2, 3, 4])
    row[column] = value
    path = write(tmp_path, HEADER, [0, 0, 0, 0, 0], row)
    with pytest.raises(InputError) as error:
        read_setpoints(path, ACTUATORS, LIMITS)
    assert str(error.value) == f"{path}: {message}"


def test_a_row_without_any_inputs_is_kept(tmp_path):
    """Where inverse kinematics failed; a row with some inputs is a mistake."""
    path = write(tmp_path, HEADER, [0, 0, 0, 0, 0], [1, *[np.nan] * 4], [2, 1e5, 2e5, 3, 4])
    found = read_setpoints(path, ACTUATORS, LIMITS)
    np.testing.assert_array_equal(found.inputs, [[0] * 4, [np.nan] * 4, [1e5, 2e5, 3, 4]])


def test_an_actuator_the_robot_has_not_is_refused(tmp_path):
    path = write(tmp_path, [*HEADER, "pressure_13_Pa"], [0, 0, 0, 0, 0, 0])
    with pytest.raises(InputError, match="column 'pressure_13_Pa': the robot has no such actuator; valid: 11, 12"):
        read_setpoints(path, ACTUATORS, LIMITS)


@pytest.mark.parametrize("missing", HEADER)
def test_missing_columns(tmp_path, missing):
    path = write(tmp_path, [name for name in HEADER if name != missing], [0, 0, 0, 0])
    with pytest.raises(InputError, match=f"column '{missing}' is missing; found: "):
        read_setpoints(path, ACTUATORS, LIMITS)


def test_a_tip_force_must_be_finite(tmp_path):
    path = write(tmp_path, [*HEADER, "tip_force_y_N"], [0, 0, 0, 0, 0, np.inf])
    with pytest.raises(InputError, match="line 2: tip_force_y_N = inf; valid: a finite number"):
        read_setpoints(path, ACTUATORS, LIMITS)
