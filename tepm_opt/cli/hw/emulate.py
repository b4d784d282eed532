"""`tepm hw emulate`: a bench without hardware, for trying the whole chain."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tepm_opt.cli.common import SOLVED, RobotOption
from tepm_opt.cli.hw.shared import say
from tepm_opt.cli.rigs import stopped_by_signals
from tepm_opt.errors import InputError, unknown_name

if TYPE_CHECKING:
    from tepm_opt.hw.simulation.rig import SimulatedRig
    from tepm_opt.models.robot import Robot

CALIBRATION = "camera.toml"
OPENIGTLINK = """
[hardware.tracker]   # the emulated tracker, written by tepm hw emulate
kind = "openigtlink"
host = "127.0.0.1"
port = {port}
devices = [{devices}]
latency_s = {latency}
"""
WEBCAM = """
[hardware.tracker]   # the emulated camera, written by tepm hw emulate
kind = "webcam"
devices = [{devices}]
rate_hz = {rate}
latency_s = {latency}

[hardware.tracker.options]
camera = "http://127.0.0.1:{port}/"
calibration = {calibration}
tag_m = {edge}
axes = "upright"
"""


def emulate(
    out: Annotated[Path, typer.Option("--out", help="Folder for the serial port and the robot file.")] = Path("bench"),
    robot: RobotOption = None,
    rig: Annotated[str, typer.Option("--rig", help="Rig file of the arm, or a built-in one.")] = "virtual_prototype",
    tracker: Annotated[str, typer.Option("--tracker", help="openigtlink, or webcam: a camera that sees tags.")] = "openigtlink",
    port: Annotated[int, typer.Option("--tracker-port", min=1024, max=65535, help="Port of the tracker's server.")] = 18944,
) -> int:
    """A board, an arm and a tracker that are not there, in real time until Ctrl-C.

    The board speaks the protocol of the firmware and keeps the host's rules, but is not the firmware.
    """
    from tepm_opt.hw.emulation.bench import EmulatedBench
    from tepm_opt.hw.simulation.rig import SimulatedRig
    from tepm_opt.hw.simulation.rigfile import builtin_rigs, load_rig_file
    from tepm_opt.hw.simulation.scaling import scale_rig
    from tepm_opt.hw.trackers.receiver import require_package
    from tepm_opt.models.robot import load_robot

    if tracker not in ("openigtlink", "webcam"):
        raise unknown_name("tracker", tracker, ("openigtlink", "webcam"), "--tracker")
    if tracker == "webcam":
        require_package("cv2", "webcam", "--tracker webcam")
    file, found = load_rig_file(rig), load_robot(robot or "kang2017")
    if rig in builtin_rigs():
        file = scale_rig(file, found)
    elif robot:
        raise InputError(f"--robot {robot}: rig {rig} names its robot itself; leave the option out, or take a built-in rig")
    arm, name = SimulatedRig(file, watched=False), str(robot or file.robot)
    text = _with_camera(name, arm, port, out) if tracker == "webcam" else _with_sensors(name, arm, port)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made ({error.strerror}); name another folder") from error
    written = out / "robot.toml"
    if written.exists() and written.read_text(encoding="utf-8") != text:
        raise InputError(f"{written} exists and is another robot file; name another folder")
    written.write_text(text, encoding="utf-8")
    if tracker == "webcam":
        _write_calibration(out / CALIBRATION)
    link = load_robot(written).hardware
    if link is None or link.tracker is None:
        raise InputError(f"{written}: it has no [hardware.tracker]; valid: a robot file with [hardware]")
    at = port if tracker == "webcam" else link.tracker.port
    with EmulatedBench(arm, out / "port", link.tracker) as bench:
        say(f"board at {out / 'port'}, tracker {tracker} at 127.0.0.1:{at}, robot file {written}; Ctrl-C ends it", "bold")
        say(f"Try it: tepm hw check {out / 'port'} --robot {written}")
        say(f"        tepm mpc circle --rig serial:{out / 'port'} --robot {written} --out loop")
        try:
            with stopped_by_signals():
                bench.run(lambda: False)
        except KeyboardInterrupt:
            say("ended")
    return SOLVED


def _text(robot: str) -> tuple[str, Robot]:
    """A robot's file, and the robot."""
    from tepm_opt.models.robot import builtin_robots, load_robot, robot_text

    return robot_text(robot) if robot in builtin_robots() else Path(robot).read_text(encoding="utf-8"), load_robot(robot)


def _with_sensors(robot: str, arm: SimulatedRig, port: int) -> str:
    """Text of the robot's file with the emulated OpenIGTLink tracker in it, unless it names one itself."""
    text, found = _text(robot)
    if found.hardware is not None and found.hardware.tracker is not None:
        if found.hardware.tracker.kind != "openigtlink":
            raise InputError(
                f"robot {robot}: its tracker is of the kind {found.hardware.tracker.kind!r}; valid: openigtlink, or no tracker"
            )
        return text
    devices = ", ".join(f'"S{number}ToTracker"' for number in range(1, arm.layout.points + 1))
    return text.rstrip("\n") + "\n" + OPENIGTLINK.format(port=port, devices=devices, latency=arm.file.tracker.latency_s)


def _with_camera(robot: str, arm: SimulatedRig, port: int, out: Path) -> str:
    """Text of the robot's file, mounted before the emulated camera, whose frame is G."""
    from tepm_opt.data.tomltext import with_numbers
    from tepm_opt.hw.emulation.camera import AGE_S, NOISE_RMS_M, frames_per_image, mount_before_camera, tag_edge

    text, found = _text(robot)
    if found.hardware is not None and found.hardware.tracker is not None:
        raise InputError(f"robot {robot}: it has a tracker of its own; valid with --tracker webcam: no [hardware.tracker]")
    rate = round(arm.file.tracker.rate_hz / frames_per_image(arm), 6)
    age = round(arm.file.tracker.latency_s + AGE_S, 6)
    mount = {key: list(value) for key, value in mount_before_camera(found).model_dump().items()}
    text = with_numbers(text, "mount", mount, robot)
    text = with_numbers(text, "tracker", {"noise_rms_m": NOISE_RMS_M, "rate_Hz": rate, "latency_s": age}, robot)
    return text.rstrip("\n") + "\n" + WEBCAM.format(
        devices=", ".join(f'"tag {number}"' for number in range(arm.layout.points)), rate=rate, latency=age, port=port,
        calibration=json.dumps(str((out / CALIBRATION).resolve())), edge=round(tag_edge(found), 6),
    )  # fmt: skip


def _write_calibration(path: Path) -> None:
    from tepm_opt.hw.emulation.camera import CAMERA
    from tepm_opt.hw.trackers.camera import calibration_text

    path.write_text(calibration_text(CAMERA.calibration, ["The emulated camera, written by tepm hw emulate."]), encoding="utf-8")
