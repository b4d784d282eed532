"""`tepm hw calibrate camera`: the camera of a tracker that sees tags, from images of a printed board."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tepm_opt.cli.common import SOLVED, stderr
from tepm_opt.cli.hw.shared import safely, say
from tepm_opt.data.files import write_atomically
from tepm_opt.errors import InputError

if TYPE_CHECKING:
    from tepm_opt.hw.service.camera import CharucoBoard, Views


def camera(
    images: Annotated[Path | None, typer.Argument(metavar="[IMAGES]", help="Folder of images of the board; without it, --camera.")] = None,
    source: Annotated[str, typer.Option("--camera", help="Number of a camera, or address of a video.")] = "0",
    views: Annotated[int, typer.Option("--views", min=6, max=200, help="Views of the board that are taken from --camera.")] = 20,
    seconds: Annotated[float, typer.Option("--seconds", min=1, max=3600, help="Time for them, s.")] = 120.0,
    squares: Annotated[str, typer.Option("--squares", help="Columns x rows of the board's squares.")] = "9x6",
    square: Annotated[float, typer.Option("--square-mm", min=2, max=200, help="Edge of a square as measured on the print, mm.")] = 28.0,
    draw: Annotated[Path | None, typer.Option("--draw-board", help="Only write the board as a PNG to print.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="File for the calibration; printed without it. Never overwritten.")] = None,
) -> int:
    """Camera of a tracker that sees tags: its matrix and distortion, from images of a printed board from all sides."""
    from tepm_opt.hw.service.camera import CharucoBoard, Views, write_board
    from tepm_opt.hw.trackers.camera import calibration_text

    if out is not None and (out.exists() or not out.parent.is_dir()):
        raise InputError(f"--out {out}: {'it exists' if out.exists() else 'there is no such folder'}; name a new file")
    board = CharucoBoard(*_squares(squares), 1e-3 * square)
    if draw is not None:
        write_board(board, draw)
        size = f"{board.columns * square:g} x {board.rows * square:g} mm"
        say(f"wrote {draw}: print it at 300 dots an inch, without scaling; the squares cover {size}. Glue it onto a flat plate.")
        return SOLVED

    def work() -> int:
        seen = Views(board)
        if images is not None:
            _take_folder(seen, images)
        else:
            _take_live(seen, int(source) if source.isdigit() else source, views, seconds, board)
        calibration, notes = seen.calibrate()
        for note in notes:
            say(note)
        text = calibration_text(calibration, [f"tepm hw calibrate camera, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC", *notes])
        if out is None:
            print(text, end="")
        else:
            write_atomically(out, text)
            say(f"wrote {out}: name it as option calibration of [hardware.tracker]")
        return SOLVED

    return safely(work, "nothing was written", "nothing was written")


def _take_folder(seen: Views, folder: Path) -> None:
    from tepm_opt.hw.service.camera import read_images

    without = [path.name for path, image in read_images(folder) if not seen.add(image)]
    if without:
        stderr.print(f"without the board: {', '.join(without)}", style="yellow", highlight=False, markup=False)


def _take_live(seen: Views, source: int | str, most: int, seconds: float, board: CharucoBoard) -> None:
    from tepm_opt.hw.service.camera import capture_images

    stderr.print(f"Move the board ({board.columns}x{board.rows}) before the camera: near and far, into each corner, tilted to all sides.")
    for image in capture_images(source, seconds):
        if seen.add(image, only_new=True):
            stderr.print(f"  view {len(seen)} of {most}", highlight=False)
        if len(seen) == most:
            return


def _squares(text: str) -> tuple[int, int]:
    """Columns and rows of a text such as 9x6.

    Raises:
        InputError: it is none.
    """
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdigit() and rows.isdigit() and 3 <= int(columns) <= 20 and 3 <= int(rows) <= 20):
        raise InputError(f"--squares {text}; valid: columns x rows, each 3 … 20, such as 9x6")
    return int(columns), int(rows)
