"""`tepm hw calibrate camera`: rendered views of the board give back the camera that they were rendered for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tepm_opt.hw.emulation.tags import Camera, NetworkCamera
from tepm_opt.hw.service.camera import CharucoBoard, Views
from tepm_opt.hw.trackers.camera import read_calibration
from tests.cli.conftest import *  # noqa: F403  its fixtures
from tests.cli.conftest import Command
from tests.hw.images import cv2, spoiled

CAMERA, BOARD = Camera(focal=612.0, centre=(331.0, 228.0)), CharucoBoard(7, 5, 0.03)


def views(count: int, seed: int) -> list[np.ndarray]:
    """Images of the board, tilted by up to 40 degrees to all sides, through blur and noise."""
    random, texture, images = np.random.default_rng(seed), BOARD.image(), []
    size = ((BOARD.columns + 1) * BOARD.square_m, (BOARD.rows + 1) * BOARD.square_m)  # with its rim
    texture = cv2.resize(texture, None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA)
    for _ in range(count):
        pose = np.eye(4)
        tilt = Rotation.from_rotvec([*random.uniform(-0.7, 0.7, 2), random.uniform(-0.3, 0.3)])
        pose[:3, :3] = (Rotation.from_rotvec([np.pi, 0, 0]) * tilt).as_matrix()
        pose[:3, 3] = [*random.uniform(-0.06, 0.06, 2), random.uniform(0.3, 0.5)]
        image = CAMERA.empty()
        CAMERA.draw(cv2, image, texture, size, pose)
        images.append(spoiled(image, random))
    return images


def test_a_camera_comes_back_from_a_folder(tepm: Command, tmp_path: Path) -> None:
    """Focal length within 1 %, its middle within 5 px; what shows no board is named; nothing is overwritten."""
    (tmp_path / "views").mkdir()
    for k, image in enumerate(views(15, 1)):
        cv2.imwrite(str(tmp_path / "views" / f"{k:02}.png"), image)
    cv2.imwrite(str(tmp_path / "views" / "wall.png"), CAMERA.empty())
    arguments = ("hw", "calibrate", "camera", str(tmp_path / "views"), "--squares", "7x5", "--square-mm", "30")
    done = tepm(*arguments, "--out", str(tmp_path / "camera.toml"))
    assert done.status == 0, done.err
    assert "wall.png" in done.err
    assert "15 views" in done.out
    found = read_calibration(tmp_path / "camera.toml")
    assert (found.width_px, found.height_px) == (640, 480)
    np.testing.assert_allclose(found.matrix[[0, 1], [0, 1]], CAMERA.focal, rtol=0.01)
    np.testing.assert_allclose(found.matrix[:2, 2], CAMERA.centre, atol=5)
    assert 0 < found.reprojection_px < 0.3
    again = tepm(*arguments, "--out", str(tmp_path / "camera.toml"))
    assert again.status == 2
    assert "exists" in again.err


def test_a_view_that_does_not_fit_is_left_out() -> None:
    """One that is squeezed, as by a bent board, would make the focal length wrong."""
    seen, taken = Views(BOARD), views(10, 2)
    squeezed = cv2.resize(taken[0], (560, 480), interpolation=cv2.INTER_AREA)
    for image in [*taken[1:], np.pad(squeezed, ((0, 0), (40, 40)), constant_values=140)]:
        assert seen.add(image)
    calibration, notes = seen.calibrate()
    assert "9 views, 1 left out" in notes[0]
    np.testing.assert_allclose(calibration.matrix[[0, 1], [0, 1]], CAMERA.focal, rtol=0.01)


def test_the_written_board_is_the_one_that_is_looked_for(tepm: Command, tmp_path: Path) -> None:
    """All its inner corners are found in the PNG itself; another number of squares is refused by name."""
    done = tepm("hw", "calibrate", "camera", "--draw-board", str(tmp_path / "board.png"), "--squares", "7x5", "--square-mm", "30")
    assert done.status == 0, done.err
    image = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    assert image.shape == (6 * 354, 8 * 354)  # 30 mm at 300 dots an inch
    _, numbers, *_ = cv2.aruco.CharucoDetector(BOARD.opencv_board(cv2)).detectBoard(image)
    assert sorted(numbers.ravel()) == list(range(6 * 4))
    assert "valid: columns x rows" in tepm("hw", "calibrate", "camera", "--squares", "7").err


def test_a_camera_that_is_looked_through(tepm: Command) -> None:
    """Views come from a network camera, each once; too few within the time is an error with the number that is needed."""
    taken = views(7, 3)
    server = NetworkCamera(cv2, lambda when: taken[int(3 * when) % len(taken)], 10.0, 0.0)
    server.start()
    arguments = ("hw", "calibrate", "camera", "--camera", server.address, "--squares", "7x5", "--square-mm", "30")
    try:
        done = tepm(*arguments, "--views", "6", "--seconds", "20")
        assert done.status == 0, done.err
        assert "view 6 of 6" in done.err
        assert "width_px = 640" in done.out
        few = tepm(*arguments, "--seconds", "1")
    finally:
        server.stop()
    assert few.status == 2
    assert "valid: at least 6" in few.err


def test_nothing_to_look_at(tepm: Command, tmp_path: Path) -> None:
    assert "no images there" in tepm("hw", "calibrate", "camera", str(tmp_path)).err
    gone = tepm("hw", "calibrate", "camera", "--camera", "http://127.0.0.1:9/")
    assert gone.status == 2
    assert "http://127.0.0.1:9/ does not open" in gone.err
