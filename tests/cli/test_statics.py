"""`tepm statics`: SPEC's check values by options, and the same by files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tepm_opt.models.robot import robot_text
from tests.cli.conftest import PNG, Command
from tests.cli.tables import input_columns, length_columns, names_in, shape_columns, summary, table, tips, write_rows

BASE_Z = -0.050  # m, base plate in G; SPEC's check values are in the base frame
CHECKS = (
    ((), (0, 0, 0.396814), 5e-7),
    (("--pressures", "2e5,2e5,2e5,3e5,3e5,3e5"), (0, 0, 0.446164), 5e-7),
    (("--tip-force", "2.5,0,0"), (0.27210, 0.00850, 0.26514), 5e-6),
)


@pytest.mark.parametrize(("options", "tip", "digits"), CHECKS, ids=["rest", "elongation", "tip force"])
def test_check_values(tepm: Command, options: tuple[str, ...], tip: tuple[float, ...], digits: float) -> None:
    done = tepm("statics", *options, "--json")
    assert (done.status, done.err) == (0, "")
    (found,) = done.json()["tip_m"]
    np.testing.assert_allclose(np.array(found) - [0, 0, BASE_Z], tip, atol=digits)


def test_check_values_in_words(tepm: Command) -> None:
    assert "0.3898 N/m" in tepm("statics").out  # SPEC: 0.38980
    assert "63.21°" in tepm("statics", "--tip-force", "2.5,0,0").out


def test_smallest_eigenvalue(tepm: Command) -> None:
    (value,) = tepm("statics", "--json").json()["smallest_stiffness_eigenvalue_N_per_m"]
    assert value == pytest.approx(0.38980, abs=5e-6)


@pytest.mark.slow
def test_rows_that_are_not_printed_are_counted(tepm: Command, here: Path, solved_circle: Path) -> None:
    told = tepm("statics", solved_circle / "inputs.csv").out
    assert told.count("\nrow ") == 8
    assert told.endswith("… and 24 more rows: --out FOLDER writes all into files\n")
    assert "… and 24 more rows: all are in shape.csv there" in tepm("statics", solved_circle / "inputs.csv", "--out", "out").out


def test_without_out_nothing_is_written(tepm: Command, here: Path) -> None:
    assert tepm("statics").status == 0
    assert names_in(here) == set()


@pytest.mark.slow
@pytest.mark.usefixtures("drawn")
def test_file_and_options_agree(tepm: Command, here: Path) -> None:
    rows = np.zeros((3, 16))
    rows[:, 0] = [0, 1, 5]
    rows[1, 1:7] = [2e5, 2e5, 2e5, 3e5, 3e5, 3e5]
    rows[2, 7:13], rows[2, 13] = 0.5, 2.5
    write_rows(here / "mine.csv", [*input_columns(), "tip_force_x_N", "tip_force_y_N", "tip_force_z_N"], rows)
    done = tepm("statics", "mine.csv", "--out", "out")
    assert (done.status, done.err) == (0, "")
    assert "3 of 3" in done.out
    assert names_in(here / "out") == {"shape.csv", "lengths.csv", "summary.json", "statics.png"}
    header, shape = table(here / "out" / "shape.csv")
    assert header == shape_columns()
    np.testing.assert_array_equal(shape[:, 0], [0, 1, 5])
    header, lengths = table(here / "out" / "lengths.csv")
    assert header == length_columns()
    assert lengths.shape == (3, 7)
    assert (here / "out" / "statics.png").read_bytes().startswith(PNG)
    options = ((), ("--pressures", "2e5,2e5,2e5,3e5,3e5,3e5"), ("--tensions", "0.5,0.5,0.5,0.5,0.5,0.5", "--tip-force", "2.5,0,0"))
    by_options = [tepm("statics", *given, "--json").json()["tip_m"][0] for given in options]
    np.testing.assert_allclose(tips(here / "out"), by_options, atol=1e-9)
    np.testing.assert_allclose(summary(here / "out", "statics")["tip_m"], by_options, atol=1e-9)


@pytest.mark.slow
def test_column_order_does_not_matter_and_more_columns_are_allowed(tepm: Command, here: Path) -> None:
    header = [*input_columns(), "pressure_11_measured_Pa"]
    row = np.array([0, 2e5, 1e5, 0, 0, 0, 3e5, 0, 0, 1, 0, 0, 0, 12345])
    write_rows(here / "a.csv", header, row)
    write_rows(here / "b.csv", header[::-1], row[::-1])
    found = [tepm("statics", name, "--json").json()["tip_m"] for name in ("a.csv", "b.csv")]
    assert found[0] == found[1]


@pytest.mark.slow
def test_effects_against_their_equivalents(tepm: Command, here: Path) -> None:
    """A payload is its weight on the tip; above 1.2 thresholds a dead zone is a smaller pressure."""
    text = 'robot = "kang2017"\n\n[[effects]]\nname = "{}"\nparameters = {{{}}}\n'
    (here / "payload.toml").write_text(text.format("payload", "mass = 0.02"))
    (here / "dead.toml").write_text(text.format("pressure_dead_zone", "threshold = 1e4"))
    pressures = "1e5,2e5,5e4,1.5e5,6e4,3e5"
    shifted = "1.1e5,2.1e5,6e4,1.6e5,7e4,3.1e5"
    for effect, plain in (
        (("--model", "payload.toml", "--pressures", pressures), ("--pressures", pressures, "--tip-force", f"0,0,{-0.02 * 9.81!r}")),
        (("--model", "dead.toml", "--pressures", shifted), ("--pressures", pressures)),
    ):
        np.testing.assert_allclose(*(tepm("statics", *options, "--json").json()["tip_m"] for options in (effect, plain)), atol=1e-8)


def test_an_arm_that_has_fallen_over_is_told(tepm: Command, here: Path) -> None:
    """22 kg instead of 220 g: it hangs, which is an equilibrium; `robot check` refuses it. Nothing is told of the paper's arm."""
    (here / "heavy.toml").write_text(robot_text("kang2017").replace("m_d = 0.22 ", "m_d = 22.0 "))
    done, check = tepm("statics", "--robot", "heavy.toml"), tepm("robot", "check", "heavy.toml")
    told = "the arm buckles under its own weight: m_d = 22 kg is too heavy; valid: up to 0.41 kg"
    assert (done.status, told in done.err) == (0, True)
    assert (check.status, told in check.err) == (2, True)
    assert tepm("statics").err == ""


@pytest.mark.slow
def test_no_stable_equilibrium_is_explained(tepm: Command, here: Path) -> None:
    """The paper's arm with 1 kg at its tip buckles: no number stands for a result."""
    (here / "m.toml").write_text('robot = "kang2017"\n\n[[effects]]\nname = "payload"\nparameters = {mass = 1.0}\n')
    done = tepm("statics", "--model", "m.toml", "--out", "out")
    assert done.status == 1
    assert done.out.startswith("0 of 1")
    assert "unstable" in done.out
    assert np.isnan(tips(here / "out")).all()
    told = summary(here / "out", "statics")
    assert told["tip_m"] == [None]
    (entry,) = told["unsolved"]
    assert (entry["point"], entry["status"]) == (0, "unstable")


def test_line_and_json_tell_the_same(tepm: Command) -> None:
    told = tepm("statics", "--tip-force", "2.5,0,0", "--json").json()
    tip = ", ".join(f"{1e3 * value:.3f}" for value in told["tip_m"][0])
    (tilt,), (stiffness,) = told["tip_tilt_deg"], told["smallest_stiffness_eigenvalue_N_per_m"]
    assert tilt == pytest.approx(63.2, abs=0.1), "the paper has about 65 degrees"
    assert f"tip ({tip}) mm, tilt {tilt:.2f}°, stiffness at least {stiffness:.4f} N/m" in tepm("statics", "--tip-force", "2.5,0,0").out
