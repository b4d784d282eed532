"""Robot files: what is wrong in one is said in one line naming file, key, value and what is valid."""

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.models.robot import UNITS, Parameters, builtin_robots, load_robot, parse_robot, robot_text
from tests.tools import variant

TEXT = robot_text("kang2017")
TRACKER = TEXT[TEXT.index("[tracker]") : TEXT.index("[hardware.pressure]")]


def test_the_built_in_robot_is_the_papers():
    """SPEC section 1."""
    robot = load_robot("kang2017")
    assert builtin_robots() == ["four_muscles", "hanging", "kang2017", "one_module", "slim"]
    assert (robot.modules, robot.actuators, robot.levels) == (2, 3, 12)
    value = robot.parameters
    assert (value.L_0, value.r, value.A, value.m_d, value.K_a) == (0.2, 0.04, 50.27e-6, 0.22, 358.86)
    assert (value.alpha_1, value.alpha_2, value.beta_1, value.beta_2) == (70, 1, 1, 1)
    assert value.c_a * 6 == pytest.approx(15.50, abs=1e-12)
    np.testing.assert_allclose(robot.angles, np.deg2rad([90, 210, 330]))
    np.testing.assert_array_equal(robot.input_max, [5e5] * 6 + [7.0] * 6)
    np.testing.assert_allclose(robot.input_step, [4.5e3] * 6 + [1.05e-3] * 6)
    assert robot.priors == {"K_a": 0.03, "m_d": 0.02, "alpha_2": 0.05, "c_a": 0.25}
    assert robot.mount.base_position_m == (0, 0, -0.05)
    assert robot.tracker.noise_rms_m == 1e-3
    assert UNITS.keys() == Parameters.model_fields.keys()


def test_a_robot_file_is_the_same_as_the_built_in_robot(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(TEXT, encoding="utf-8")
    assert load_robot(path) == load_robot(str(path)) == load_robot("kang2017")


def test_a_robot_file_may_begin_with_a_byte_order_mark(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("\ufeff" + TEXT, encoding="utf-8")
    assert load_robot(path) == load_robot("kang2017")


def test_base_rotation_is_a_rotation_vector_into_g():
    mount = variant(mount={"base_rotation_deg": (0.0, 0.0, 90.0)}).mount
    np.testing.assert_allclose(mount.rotation @ [1, 0, 0], [0, 1, 0], atol=1e-15)


MALFORMED = {
    "unknown key": ("modules = 2", "modules = 2\nmodulus = 2", "geometry: unknown key 'modulus': ", "modules, segments_per_module"),
    "misspelt key": (
        "modules = 2",
        "moduls = 2",
        "geometry: unknown key 'moduls': did you mean 'modules'?",
        "modules, segments_per_module",
    ),
    "unknown table": ("[tracker]", "[camera]\nnoise = 1\n[tracker]", "unknown key 'camera': ", "tracker"),
    "missing key": ("m_d = 0.22 ", "", "parameters: missing key 'm_d'", "0.0001 … 100 kg"),
    "missing table": (TRACKER, "", "missing key 'tracker'", ""),
    "pressure in MPa": ("pressure_max_Pa = 0.5e6", "pressure_max_Pa = 0.5", "actuation: pressure_max_Pa = 0.5: ", "1000 … 2e+07 Pa"),
    "length in mm": ("L_0 = 0.200", "L_0 = 200", "parameters: L_0 = 200: ", "0.001 … 10 m"),
    "area in mm2": ("A = 50.27e-6", "A = 50.27", "parameters: A = 50.27: ", "1e-07 … 0.01 m^2"),
    "mass in g": ("m_d = 0.22 ", "m_d = 220 ", "parameters: m_d = 220: ", "0.0001 … 100 kg"),
    "gravity in mm/s2": ("-9.81]", "-9810]", "mount: gravity_m_per_s2 has the magnitude 9810", "0 … 30 m/s^2"),
    "base in mm": ("-0.050]", "-500]", "mount: base_position_m is further than 10 m", "metres"),
    "resolution in Pa": ("resolution = 0.005", "resolution = 4500", "actuation: pressure_resolution = 4500: ", "0 … 0.5 of full scale"),
    "stiffness 0": ("K_a = 358.86", "K_a = 0", "parameters: K_a = 0: ", "5 … 100000 N/m"),
    "stiffness below 0": ("alpha_2 = 1 ", "alpha_2 = -1 ", "parameters: alpha_2 = -1: ", "1e-06 … 100000"),
    "NaN": ("K_a = 358.86", "K_a = nan", "parameters: K_a = nan: input should be a finite number", "0 … 100000 N/m"),
    "infinite": ("[0, 0, -9.81]", "[0, 0, -inf]", "mount: gravity_m_per_s2 entry 3 = -inf: input should be a finite", "three numbers"),
    "text for a number": ("K_a = 358.86", 'K_a = "358.86"', "parameters: K_a = '358.86': input should be a valid number", "0 … 100000 N/m"),
    "true for a number": ("modules = 2", "modules = true", "geometry: modules = True: input should be a valid integer", "1 … 20"),
    "fraction of a module": ("modules = 2", "modules = 2.5", "geometry: modules = 2.5: input should be a valid integer", "1 … 20"),
    "no segments": ("segments_per_module = 6", "segments_per_module = 0", "geometry: segments_per_module = 0: ", "1 … 100"),
    "two actuators": ("[90, 210, 330]", "[90, 270]", "geometry: actuator_angles_deg = [90, 270]: ", "3 … 12 angles"),
    "equal angles": ("[90, 210, 330]", "[90, 330, -30]", "geometry: actuator_angles_deg: two actuators sit at the same", "1 deg apart"),
    "two components": ("[0, 0, -9.81]", "[0, -9.81]", "mount: gravity_m_per_s2 = [0, -9.81]: too few values", "three numbers"),
    "angles on one side": ("[90, 210, 330]", "[90, 100, 260]", "geometry: actuator_angles_deg: all actuators sit on one side", "180 deg"),
    "unknown bracing": ('"crossed"', '"cross"', "geometry: unknown bracing 'cross': did you mean 'crossed'? valid: ", "crossed, single"),
    "prior of no parameter": ("K_a = 0.03", "K_b = 0.03", "priors: unknown parameter 'K_b': did you mean 'K_a'? valid: A, K_a, L_0", "r"),
    "range beyond full scale": (
        "tension_max_N = 7.0",
        "tension_max_N = 8.0",
        "actuation: tension_max_N = 8 exceeds",
        "tension_full_scale_N = 7",
    ),
    "table for a number": ("K_a = 358.86", "K_a = {value = 1}", "parameters: K_a = {'value': 1}: input should be a valid number", "N/m"),
    "angle beyond a turn": ("[90, 210, 330]", "[90, 210, 1330]", "geometry: actuator_angles_deg entry 3 = 1330: ", "3 … 12 angles"),
    "prior in per cent": ("K_a = 0.03", "K_a = 30", "priors: K_a = 30: input should be less", "0 … 10 relative half-width"),
    "holder of no sensor": (
        "[hardware.pressure]",
        '[hardware.tracker]\ndevices = ["Tip", "Base"]\nholders_m = [[0, 0, 0.01]]\n[hardware.pressure]',
        "hardware: tracker: holders_m has 1 entries",
        "one for each",
    ),
    "unknown key of the electronics": (
        "[hardware.pressure]",
        "[hardware.pressure]\nV_per_Mpa = 5.5",
        "hardware: pressure: unknown key 'V_per_Mpa': did you mean 'V_per_MPa'?",
        "zero_V",
    ),
    "calibration out of range": (
        "\nzero_V = 0.0",
        "\nzero_V = [0, 0, 50]",
        "hardware: pressure: zero_V = [0, 0, 50]: outside its range; valid: ",
        "-1 … 5 V, one number or one for each actuator",
    ),
    "text in a calibration": (
        "\nzero_V = 0.0",
        '\nzero_V = [0, "x"]',
        "hardware: pressure: zero_V",
        "a number",
    ),
    "not TOML": ("K_a = 358.86", "K_a 358.86", "not valid TOML: ", "(at line 16, column 5)"),
    "key twice": ("m_d = 0.22 ", "m_d = 0.22\nm_d = 0.22 ", "not valid TOML: ", "(at line 16, column 11)"),
}


@pytest.mark.parametrize(("old", "new", "found", "valid"), MALFORMED.values(), ids=MALFORMED)
def test_malformed_robot_files(tmp_path, old, new, found, valid):
    path = tmp_path / "mine.toml"
    assert old in TEXT
    path.write_text(TEXT.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as error:
        load_robot(path)
    message = str(error.value)
    assert message.startswith(f"{path}: {found}")
    assert valid in message
    assert "\n" not in message


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="is not a text file"):
        load_robot(tmp_path / "binary.toml")
    with pytest.raises(
        InputError, match="robot 'kang' is neither a file nor built in; built in: four_muscles, hanging, kang2017, one_module, slim"
    ):
        load_robot("kang")
    with pytest.raises(InputError, match="unknown robot 'kang2018': did you mean 'kang2017'"):
        robot_text("kang2018")


def test_a_robot_is_frozen():
    with pytest.raises(ValueError, match="frozen"):
        parse_robot(TEXT, "kang2017").parameters.K_a = 1.0
