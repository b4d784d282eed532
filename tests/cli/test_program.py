"""The program as a whole: JSON, robot files, the demo, reproducibility, the installed script."""

from __future__ import annotations

import base64
import io
import json
import re
import shlex
import shutil
import sys
import warnings
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt import load_robot
from tepm_opt.cli import run
from tepm_opt.jobs import ik as job
from tepm_opt.models.backends import compiler, store
from tepm_opt.outcome import Ending
from tepm_opt.outcome import Outcome as Ended
from tests.cli.conftest import Command, Outcome, script, small_demo
from tests.cli.tables import IK_FILES, names_in, summary, values


class Page(HTMLParser):
    """Attributes of all elements of a page, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


class TestJson:
    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("command", "keys"),
        [
            ("ik circle --points 2", {"robot", "mode", "points", "solved", "unsolved"}),
            ("gain CIRCLE/inputs.csv", {"robot", "reference_point", "normalised"}),
            ("statics", {"tip_m", "smallest_stiffness_eigenvalue_N_per_m"}),
            ("statics CIRCLE/inputs.csv --out out", {"tip_m"}),
            ("robot show", {"name", "geometry", "parameters", "actuation", "mount", "tracker"}),
            ("robot check kang2017", {"robot", "modules", "actuators", "levels"}),
            ("robot new mine.toml", {"file"}),
        ],
    )
    @pytest.mark.usefixtures("quick")
    def test_json_and_nothing_else(self, tepm: Command, solved_circle: Path, command: str, keys: set[str]) -> None:
        done = tepm(*shlex.split(command.replace("CIRCLE", str(solved_circle))), "--json")
        assert (done.status, done.err) == (0, "")
        assert keys <= done.json().keys()

    @pytest.mark.slow
    def test_the_same_as_in_the_file(self, tepm: Command, here: Path) -> None:
        assert tepm("ik", "line", "--points", 2, "--out", "out", "--json").json() == summary(here / "out", "ik")

    @pytest.mark.slow
    def test_out_of_reach(self, tepm: Command) -> None:
        done = tepm("ik", "circle", "--points", 1, "--radius", 0.6, "--json")
        assert done.status == 1
        assert done.json()["unsolved"][0]["limits"]


class TestRobotFiles:
    def test_show(self, tepm: Command) -> None:
        done = tepm("robot", "show")
        assert done.status == 0
        for text in ("kang2017", "K_a", "358.86", "segments_per_module", "pressure_full_scale_Pa", "900000"):
            assert text in done.out

    def test_new_is_the_built_in_robot_by_another_name(self, tepm: Command, here: Path) -> None:
        done = tepm("robot", "new", "arm.toml")
        assert done.status == 0
        assert "tepm robot check arm.toml" in done.out
        assert load_robot("arm.toml") == load_robot("kang2017").model_copy(update={"name": "arm"})
        assert "# N/m" in (here / "arm.toml").read_text(), "the comments must come along"

    def test_check(self, tepm: Command) -> None:
        tepm("robot", "new", "arm.toml")
        done = tepm("robot", "check", "arm.toml")
        assert done.status == 0
        assert "valid" in done.out

    def test_new_of_any_file_name_can_be_read(self, tepm: Command) -> None:
        assert tepm("robot", "new", 'my "arm".toml').status == 0
        assert load_robot('my "arm".toml').name == 'my "arm"'


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """Folder of a small `tepm demo --out out` with its figures drawn, and what it said. Read only."""
    here, out, err = tmp_path_factory.mktemp("demo"), io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        small_demo(patch)
        patch.chdir(here)
        status = run(["demo", "--out", "out"])
    return here, Outcome(status, out.getvalue(), err.getvalue())


class TestDemo:
    def test_files_page_and_status(self, small: tuple[Path, Outcome]) -> None:
        here, done = small
        assert (done.status, done.err) == (0, "")
        assert "out/index.html" in done.out
        loops = {"loop_path.png", "loop_distance.png", "loop_inputs.png"}
        assert names_in(here / "out") == IK_FILES | {"gain.csv", "gain.png", "gain_map.csv", "index.html"} | loops
        assert {"ik", "gain", "closed_loop"} <= json.loads((here / "out" / "summary.json").read_text()).keys()

        text = (here / "out" / "index.html").read_text(encoding="utf-8")
        page = Page(text)
        assert not {tag for tag, _ in page.elements} & {"link", "iframe", "object", "embed", "base"}
        own = re.sub(r"base64,[A-Za-z0-9+/=]+|http://www\.w3\.org/2000/svg", "", text)
        assert not re.search(r"https?://|//[a-z]+\.|url\((?!#)|@import", own)
        sources = [attributes["src"] or "" for _, attributes in page.elements if "src" in attributes]
        figures = {base64.b64decode(source.removeprefix("data:image/png;base64,"), validate=True) for source in sources}
        assert figures == {(here / "out" / name).read_bytes() for name in {"ik.png", "gain.png"} | loops - {"loop_distance.png"}}
        assert all(attributes.get("alt") for tag, attributes in page.elements if tag == "img")

        words = " ".join(page.text.split())
        told = summary(here / "out", "ik")
        assert "4 of 4 points of the path are solved" in words
        assert list(summary(here / "out", "closed_loop")) == ["mode 1", "mode 2", "MPC"]
        for name, loop in summary(here / "out", "closed_loop").items():
            error = f"{1e3 * loop['errors']['true']['rms_m']:#.3g}".rstrip(".") + " mm"
            assert (f"within {error} rms" if name == "MPC" else f"{error} in {name}") in words
            assert f"{name} {1e3 * loop['errors']['true']['rms_m']:.3g}" in done.out.splitlines()[0]
        assert f"{1e3 * told['largest_rounded_tip_error_m']:#.3g} mm" in words
        assert "358.86" in words

    @pytest.mark.slow
    @pytest.mark.usefixtures("quick")
    def test_a_robot_that_cannot_reach_the_circle(self, tepm: Command, here: Path) -> None:
        tepm("robot", "new", "short.toml")
        text = (here / "short.toml").read_text()
        (here / "short.toml").write_text(text.replace("modules = 2", "modules = 1").replace("module = 6", "module = 12"))
        done = tepm("demo", "--robot", "short.toml", "--out", "out")
        assert done.status == 1
        page = Page((here / "out" / "index.html").read_text(encoding="utf-8"))
        assert "0 of 4" in page.text
        assert "out of reach" in page.text
        assert "Not run: not all points of the circle were solved." in page.text
        assert not {name for name in names_in(here / "out") if name.startswith("loop_")}

    @pytest.mark.slow
    @pytest.mark.usefixtures("quick")
    def test_a_point_that_fails(self, tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        solve = job.each_configuration

        def each(*arguments: Any, **options: Any) -> Iterator[Any]:
            for number, found in enumerate(solve(*arguments, **options)):
                yield replace(found, outcome=Ended(Ending.FAILED, "it fails")) if number == 2 else found

        monkeypatch.setattr(job, "each_configuration", each)
        done = tepm("demo", "--out", "out")
        assert done.status == 1, done.err
        assert "point 3: it fails" in done.out
        assert "it fails" in (here / "out" / "index.html").read_text(encoding="utf-8")
        assert np.isnan(values(here / "out" / "inputs.csv")).any(axis=1).tolist() == [False, False, True, False]


class TestReproducibility:
    @pytest.mark.usefixtures("quick", "drawn")
    @pytest.mark.slow
    def test_two_runs_write_the_same_bytes(self, tepm: Command, here: Path, small: tuple[Path, Outcome]) -> None:
        done = tepm("demo", "--out", "out", "--json")
        assert (done.status, done.err) == (0, "")
        assert done.json().keys() == {"interrupted", "ik", "ik_pressure", "gain", "closed_loop"}
        first, again = ({path.name: path.read_bytes() for path in (folder / "out").iterdir()} for folder in (small[0], here))
        assert first.keys() == again.keys()
        assert [name for name in first if first[name] != again[name]] == []

    @pytest.mark.slow
    @pytest.mark.usefixtures("drawn")
    def test_statics_writes_the_same_bytes_twice(self, tepm: Command, here: Path, solved_circle: Path) -> None:
        for name in "ab":
            assert tepm("statics", solved_circle / "inputs.csv", "--out", name).status == 0
        first, again = ({path.name: path.read_bytes() for path in (here / name).iterdir()} for name in "ab")
        assert first == again

    @pytest.mark.slow
    def test_installed_script_writes_the_same_bytes(self, here: Path, solved_circle: Path) -> None:
        done = script("ik", "circle", "--out", "out")
        assert (done.status, done.err) == (0, "")
        assert "32 of 32" in done.out
        for name in ("inputs.csv", "inputs_rounded.csv", "shape.csv", "lengths.csv", "ik.png"):
            assert (here / "out" / name).read_bytes() == (solved_circle / name).read_bytes(), name
        assert summary(here / "out", "ik") == summary(solved_circle, "ik")

    @pytest.mark.slow
    @pytest.mark.usefixtures("drawn")
    def test_second_run_into_the_same_folder(self, tepm: Command, here: Path, solved_circle: Path) -> None:
        shutil.copytree(solved_circle, here / "out")
        assert tepm("ik", "circle", "--out", "out").status == 0
        for path in solved_circle.iterdir():
            assert (here / "out" / path.name).read_bytes() == path.read_bytes(), path.name


class TestHelp:
    @pytest.mark.parametrize("command", ["", "ik", "gain", "statics", "mpc", "demo", "robot", "robot new"])
    def test_help(self, tepm: Command, command: str) -> None:
        done = tepm(*command.split(), "--help")
        assert (done.status, done.err) == (0, "")
        assert "Usage" in done.out

    @pytest.mark.parametrize("command", ["", "robot"])
    def test_no_arguments_show_the_help_without_an_error_about_nothing(self, tepm: Command, command: str) -> None:
        done = tepm(*command.split())
        assert "Usage" in done.out + done.err
        assert "error: (see" not in done.err


class TestTerminals:
    def test_one_that_knows_ascii_only(self, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """What it cannot show is spelt; a name of a file that nothing stands for becomes a question mark."""
        streams = {name: io.TextIOWrapper(io.BytesIO(), encoding="ascii") for name in ("stdout", "stderr")}
        for name, stream in streams.items():
            monkeypatch.setattr(sys, name, stream)
        assert run(["statics", "--tip-force", "2.5,0,0"]) == 0
        assert run(["statics", "größe.csv"]) == 2
        out, err = ((stream.flush(), stream.buffer.getvalue().decode("ascii"))[1] for stream in streams.values())  # type: ignore[attr-defined]
        assert "tilt 63.21 deg, stiffness" in out
        assert "gr??e.csv" in err

    def test_without_a_compiler_one_line_says_so(
        self, here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        store.warn_once.cache_clear()
        monkeypatch.setattr(compiler, "find_compiler", lambda: None)
        capsys.readouterr()
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            assert run(["statics"]) == 0
        said = capsys.readouterr().err
        assert said == f"warning: {compiler.NONE}\n"
