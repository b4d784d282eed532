"""A simulated motion as a film: MP4 where ffmpeg is found, else GIF, ten times as large; what was drawn before an interruption is kept.

Frames come in real time, 25 a second; very long motions are shown faster. GIF frames share one palette, made for what a scene shows:
nothing flickers, quantising is quick and two films of one motion are the same bytes.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterable, Iterator
from importlib import import_module, util
from pathlib import Path
from typing import IO, Literal, cast

import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image

from tepm_opt.data.files import atomic_path
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.plots.palette import GOOD
from tepm_opt.plots.scene import COLOURS, EDGE, FLOOR, HEIGHT, PLATE, RING, WIDTH, Scene
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.mechanics.simulate import Simulation

Kind = Literal["mp4", "gif", "none"]
KINDS: tuple[Kind, ...] = ("mp4", "gif", "none")
NAMES = {"mp4": "animation.mp4", "gif": "animation.gif"}
INSTALL = "install it, or pip install 'tepm-opt[film]'"
FPS = 25
MOST_FRAMES = 1000  # 40 s
BLENDS = (0.25, 0.5, 0.75)  # how much white smooth edges are mixed with
GREYS = 33  # no more: Pillow rounds colours to steps of 4 before it looks for the nearest, and white must stay white


def find_ffmpeg() -> str | None:
    """The program ffmpeg: the system's, or that of the PyPI package imageio-ffmpeg where it is installed; None without one."""
    if found := shutil.which("ffmpeg"):
        return found
    if util.find_spec("imageio_ffmpeg") is None:
        return None
    try:
        return import_module("imageio_ffmpeg").get_ffmpeg_exe()
    except RuntimeError:  # the package is there, its program is not
        return None


def choose(kind: str | None) -> Kind:
    """The kind of film asked for, or the best one here.

    Raises:
        InputError: no such kind, or "mp4" without ffmpeg.
    """
    if kind is None:
        return "mp4" if find_ffmpeg() else "gif"
    if kind == "mp4" and find_ffmpeg() is None:
        raise InputError(f"--animation mp4: ffmpeg is not found ({INSTALL}); valid: gif, none")
    for valid in KINDS:
        if kind == valid:
            return valid
    raise unknown_name("animation", kind, KINDS)


def frames(time: np.ndarray) -> tuple[np.ndarray, float]:
    """The instants to draw, and how many times as fast as real time they are shown.

    Args:
        time: of all instants in s, (instants,).
    """
    duration = float(time[-1] - time[0])
    faster = max(1.0, duration * FPS / (MOST_FRAMES - 1))
    moments = time[0] + faster / FPS * np.arange(int(duration * FPS / faster + 1e-6) + 1)
    after = np.searchsorted(time, moments - 1e-9).clip(1, max(1, len(time) - 1)) if len(time) > 1 else np.zeros(len(moments), dtype=int)
    before = np.maximum(after - 1, 0)
    return np.where(moments - time[before] <= time[after] - moments, before, after), faster


def save(simulation: Simulation, folder: str | Path, kind: Kind, progress: Progress = silent) -> tuple[Path | None, bool]:
    """Draw a simulation as `animation.mp4` or `animation.gif`.

    Args:
        simulation: the motion.
        folder: where the film goes.
        kind: "mp4", "gif" or "none".
        progress: told about the pictures drawn.

    Returns:
        The film's path (None where there is none) and whether it is whole: an interruption (Ctrl-C) ends it early.

    Raises:
        InputError: the folder cannot be written to; ffmpeg fails.
    """
    if kind == "none" or not len(simulation.setpoints.time):
        return None, True
    instants, faster = frames(simulation.setpoints.time)
    pictures = _Pictures(simulation, instants, "" if faster == 1 else f", shown {faster:.3g} times as fast", progress)
    path = Path(folder) / NAMES[kind]
    with atomic_path(path) as temporary:
        (_save_mp4 if kind == "mp4" else _save_gif)(pictures, temporary)
        if not pictures.drawn:
            raise KeyboardInterrupt
    return path, not pictures.interrupted


class _Pictures:
    """The pictures of a film one by one, until the user interrupts.

    Attributes:
        drawn: number of those drawn.
        interrupted: whether they ended early.
    """

    def __init__(self, simulation: Simulation, instants: np.ndarray, note: str, progress: Progress) -> None:
        self.drawn, self.interrupted = 0, False
        self._simulation, self._instants, self._note, self._progress = simulation, instants, note, progress

    def __iter__(self) -> Iterator[np.ndarray]:
        try:
            scene = Scene(self._simulation, self._note)
            for instant in self._instants:
                yield scene.image(int(instant))
                self.drawn += 1
                self._progress("film", self.drawn, len(self._instants))
        except KeyboardInterrupt:
            self.interrupted = True


def palette() -> Image.Image:
    """A picture with the palette of all GIFs: greys, the colours of the scale and of the lines, and both mixed with white."""
    colours = [*COLOURS(np.linspace(0, 1, COLOURS.N))[:, :3], *(np.array(to_rgb(name)) for name in (GOOD.color, EDGE, RING, PLATE, FLOOR))]
    mixed = [colour + blend * (1 - colour) for blend in (0.0, *BLENDS) for colour in colours]
    greys = [np.full(3, value) for value in np.linspace(0, 1, GREYS)]
    image = Image.new("P", (1, 1))
    image.putpalette(np.round(255 * np.array(mixed + greys)).astype(np.uint8).tobytes())
    return image


def _save_gif(pictures: Iterable[np.ndarray], path: Path) -> None:
    shared = palette()
    kept = [Image.fromarray(picture.copy()).quantize(palette=shared, dither=Image.Dither.NONE) for picture in pictures]
    if kept:
        kept[0].save(path, format="GIF", save_all=True, append_images=kept[1:], duration=1000 // FPS, loop=0, optimize=False)


def _save_mp4(pictures: Iterable[np.ndarray], path: Path) -> None:
    """Feed ffmpeg, which runs in a session of its own, so that Ctrl-C reaches this program alone and the film is ended properly."""
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{WIDTH}x{HEIGHT}", "-r", str(FPS), "-i", "-"]
    same_bytes = ["-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact", "-threads", "1"]
    program = find_ffmpeg() or "ffmpeg"
    command = [program, "-loglevel", "error", "-nostdin", "-y", *source, "-an", "-pix_fmt", "yuv420p", *same_bytes, str(path)]
    try:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True)
    except OSError as error:
        raise InputError(f"ffmpeg cannot be started: {error.strerror}; --animation gif needs none") from error
    try:
        pipe = cast("IO[bytes]", process.stdin)  # it was asked for above
        for picture in pictures:
            pipe.write(picture.tobytes())
    except BrokenPipeError:
        pass  # it says why below
    except BaseException:
        process.kill()
        raise
    finally:
        said = process.communicate()[1].decode(errors="replace").strip()
    if process.returncode:
        raise InputError(f"ffmpeg failed: {said.splitlines()[-1] if said else process.returncode}; --animation gif needs none")
