"""Films: which instants, what they show, formats, same bytes, interruption."""

from __future__ import annotations

import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel
from tepm_opt.plots import film as films
from tepm_opt.plots.scene import HEIGHT, WIDTH, Scene
from tepm_opt.solvers.mechanics.simulate import Simulation, simulate


@pytest.fixture(scope="module")
def short(kang: CompiledModel) -> Simulation:
    """0.4 s in which A_11 rises from 0 to 3 bar, at 100 Hz."""
    time = np.arange(41) * 0.01
    inputs = np.zeros((41, 12))
    inputs[:, 0] = np.linspace(0, 3e5, 41)
    return simulate(kang, SetPoints(time, inputs, np.zeros((41, 3)))).complete()


def test_frames_are_25_a_second_of_real_time() -> None:
    instants, faster = films.frames(np.arange(1001) * 0.02)
    assert (len(instants), faster) == (501, 1.0)
    np.testing.assert_allclose(instants * 0.02, np.arange(501) * 0.04)


@pytest.mark.parametrize("time", [np.array([3.0]), np.array([0.0, 0.01]), np.array([5.0, 5.5, 7.0]), np.linspace(0, 3600, 5000)])
def test_frames_of_odd_times(time: np.ndarray) -> None:
    instants, faster = films.frames(time)
    assert instants[0] == 0
    assert (np.diff(instants) >= 0).all()
    assert instants.max() < len(time)
    assert len(instants) <= films.MOST_FRAMES
    assert faster == pytest.approx(max(1.0, np.ptp(time) * 25 / (films.MOST_FRAMES - 1)))


def test_nodes_are_in_the_frame_of_the_points(short: Simulation) -> None:
    np.testing.assert_allclose(Scene(short).nodes[:, -1].mean(axis=1), 1e3 * short.tip, atol=1e-6)


def test_pictures_differ_where_the_arm_is_and_nowhere_else(short: Simulation) -> None:
    """The axes stand still: what changes lies within the axes and the clock; the muscle changes its colour."""
    scene = Scene(short)
    first, last, again = (scene.image(k).copy() for k in (0, 40, 0))
    assert first.shape == (HEIGHT, WIDTH, 3)
    np.testing.assert_array_equal(first, again)
    changed = (first != last).any(axis=-1)
    assert 0.001 < changed.mean() < 0.2
    assert not changed[:, int(0.86 * WIDTH) :].any()
    assert not changed[int(0.95 * HEIGHT) :].any()


def test_labels_are_inside_the_picture(short: Simulation) -> None:
    picture = Scene(short).image(0)
    for border in (picture[:4], picture[-4:], picture[:, :4], picture[:, -4:]):
        assert (border == 255).all()


@pytest.mark.slow
def test_gif(short: Simulation, tmp_path: Path) -> None:
    told: list[tuple[str, float, float]] = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        path, whole = films.save(short, tmp_path / name, "gif", lambda *each: told.append(each))
        assert (path, whole) == (tmp_path / name / "animation.gif", True)
        assert [file.name for file in (tmp_path / name).iterdir()] == ["animation.gif"]
    assert told == [("film", k, 11) for k in range(1, 12)] * 2
    assert (tmp_path / "one" / "animation.gif").read_bytes() == (tmp_path / "two" / "animation.gif").read_bytes()
    with Image.open(tmp_path / "one" / "animation.gif") as film:
        assert (film.n_frames, film.size, film.info["duration"]) == (11, (WIDTH, HEIGHT), 40)  # type: ignore[attr-defined]
        film.seek(10)
        shown = np.asarray(film.convert("RGB")).astype(int)
    drawn = Scene(short).image(40).astype(int)
    assert (shown[:30, :10] == 255).all(), "white stays white"
    assert np.abs(shown - drawn).mean() < 1.0


def test_a_still_robot_can_be_filmed(short: Simulation, tmp_path: Path) -> None:
    """Pictures that are all the same but for the clock, and a single one."""
    one = replace(
        short, setpoints=SetPoints(np.zeros(1), np.zeros((1, 12)), np.zeros((1, 3))), points=short.points[:1], levels=short.levels[:1]
    )
    path, whole = films.save(one, tmp_path, "gif")
    assert path is not None
    assert whole


def test_interruption_before_the_first_picture_leaves_nothing(short: Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Scene, "image", interrupted)
    with pytest.raises(KeyboardInterrupt):
        films.save(short, tmp_path, "gif")
    assert list(tmp_path.iterdir()) == []


def test_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: f"/bin/{name}")
    assert [films.choose(kind) for kind in (None, "gif", "none", "mp4")] == ["mp4", "gif", "none", "mp4"]
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(films.util, "find_spec", lambda name: object())
    monkeypatch.setattr(films, "import_module", lambda name: SimpleNamespace(get_ffmpeg_exe=lambda: f"/of/{name}"))
    assert (films.find_ffmpeg(), films.choose(None)) == ("/of/imageio_ffmpeg", "mp4")
    monkeypatch.setattr(films.util, "find_spec", lambda name: None)
    assert films.choose(None) == "gif"
    for kind, says in (("mp4", "ffmpeg"), ("webm", "'webm'")):
        with pytest.raises(InputError, match=says):
            films.choose(kind)


def test_mp4(short: Simulation, tmp_path: Path) -> None:
    if films.find_ffmpeg() is None:
        pytest.skip("no ffmpeg on this machine")
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        assert films.save(short, tmp_path / name, "mp4") == (tmp_path / name / "animation.mp4", True)
    film = (tmp_path / "one" / "animation.mp4").read_bytes()
    assert film[4:8] == b"ftyp"
    assert film == (tmp_path / "two" / "animation.mp4").read_bytes()


FAKE = """#!{python}
import pathlib, sys
picture = 720 * 640 * 3
data = sys.stdin.buffer.read({read})
if {fails}:
    sys.exit("Unknown encoder")
pathlib.Path(sys.argv[-1]).write_text(f"{{len(data) / picture:g}} pictures")
"""


@pytest.mark.skipif(os.name != "posix", reason="a program made of a script")
@pytest.mark.parametrize("fails", [False, True])
def test_what_ffmpeg_is_given_and_how_its_failure_is_told(
    short: Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: bool
) -> None:
    fake, out = tmp_path / "bin" / "ffmpeg", tmp_path / "out"
    fake.parent.mkdir()
    out.mkdir()
    fake.write_text(FAKE.format(python=sys.executable, read=10 if fails else -1, fails=fails))
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", str(fake.parent))
    if fails:
        with pytest.raises(InputError, match="Unknown encoder"):
            films.save(short, out, "mp4")
        assert list(out.iterdir()) == []
        return
    films.save(short, out, "mp4")
    assert (out / "animation.mp4").read_text() == "11 pictures"
