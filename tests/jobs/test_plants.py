"""Plant files: what is taken, and one clear line for what is not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tepm_opt.errors import InputError
from tepm_opt.jobs.discrepancy import run_discrepancy
from tepm_opt.jobs.plants import load_plant

GOOD = """from tepm_opt.discrepancy.adapters.equations import Equations

m = Equations("a lag", laws=())
x = m.state("x")
m.rate(x, m.input("u", size=1.0) - x)
m.output("x", x)
plant = m.plant()
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "machine.py"
    path.write_text(text)
    return path


def test_a_plant(tmp_path: Path) -> None:
    assert load_plant(written(tmp_path, GOOD)).name == "a lag"


def test_a_function_that_gives_a_plant(tmp_path: Path) -> None:
    assert load_plant(written(tmp_path, GOOD.replace("plant = m.plant()", "plant = m.plant"))).name == "a lag"


def test_a_file_may_import_what_lies_beside_it(tmp_path: Path) -> None:
    (tmp_path / "my_constants_of_a_lag.py").write_text("SIZE = 1.0\n")
    text = "from my_constants_of_a_lag import SIZE\n" + GOOD.replace("size=1.0", "size=SIZE")
    assert load_plant(written(tmp_path, text)).name == "a lag"


class TestWhatLiesBeside:
    @pytest.fixture
    def beside(self, tmp_path: Path) -> Path:
        path = tmp_path / "my_machine_of_a_lag.py"
        path.write_text('NAME = "a lag"\n')
        written(tmp_path, "from my_machine_of_a_lag import NAME\n" + GOOD.replace('"a lag"', "NAME"))
        return path

    def test_is_read_anew_when_it_has_changed(self, beside: Path) -> None:
        assert load_plant(beside.with_name("machine.py")).name == "a lag"
        beside.write_text('NAME = "another lag, further off"\n')
        assert load_plant(beside.with_name("machine.py")).name == "another lag, further off"

    def test_is_part_of_what_fits_are_kept_for(self, beside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """A search that was interrupted does not go on with fits of another machine."""
        data, keys = tmp_path / "data", []
        data.mkdir()
        (data / "dataset.toml").write_text('name = "lags"\nruns = [{ file = "r.csv", role = "fit" }]\n[noise]\nx = 0.1\n')
        (data / "r.csv").write_text("time_s,u,x\n0,1,1\n1,1,1\n")

        def asked(*arguments: Any) -> None:
            keys.append(arguments[4].key)
            raise KeyboardInterrupt

        monkeypatch.setattr("tepm_opt.jobs.discrepancy.discover", asked)
        for text in ('NAME = "a lag"\n', 'NAME = "a lag"\n', 'NAME = "another"\n'):
            beside.write_text(text)
            with pytest.raises(KeyboardInterrupt):
                run_discrepancy(data, tmp_path / "out", plant=beside.with_name("machine.py"))
        assert keys[0] == keys[1] != keys[2]


WRONG = {
    "no plant": ("x = 1\n", "has no plant; valid: a file that ends with plant = …"),
    "another thing": ("plant = 3\n", "plant is a int without 'signals'; valid: Equations(…).plant() or"),
    "fails": ("x = 1\ny = x / 0\n", "line 2: ZeroDivisionError: division by zero"),
    "is no Python": ("x = = 1\n", "line 1: SyntaxError: invalid syntax"),
    "a machine that is refused": (GOOD.replace("m.output", "# "), "a lag: nothing is measured; valid: at least one m.output(…)"),
    "a name that is not there": (GOOD.replace("size=1.0", "sise=1.0"), "line 5: TypeError:"),
    "many lines": ("raise ValueError('one\\n  two')\n", "line 1: ValueError: one two"),
    "an end": ("raise SystemExit(3)\n", "line 1: SystemExit: 3"),
    "fails where the plant is made": (GOOD.replace("plant = m.plant()", "def plant():\n    return 1 / 0"), "line 8: ZeroDivisionError"),
}


@pytest.mark.parametrize(("text", "says"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_told_in_a_line(tmp_path: Path, text: str, says: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as error:
        load_plant(path)
    assert str(error.value).startswith(f"{path}: {says}")
    assert "\n" not in str(error.value)


def test_no_file(tmp_path: Path) -> None:
    for name in ("nothing.py", "nothing", "."):
        with pytest.raises(InputError, match=r"no such Python file; valid: a file that ends with plant = …"):
            load_plant(tmp_path / name)
    (tmp_path / "text.txt").write_text(GOOD)
    with pytest.raises(InputError, match="no such Python file"):
        load_plant(tmp_path / "text.txt")
