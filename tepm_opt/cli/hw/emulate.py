"""`tepm hw emulate`: a bench without hardware, for trying the whole chain."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tepm_opt.cli.common import SOLVED, RobotOption
from tepm_opt.cli.hw.shared import say
from tepm_opt.cli.rigs import stopped_by_signals
from tepm_opt.errors import InputError

TABLE = """
[hardware.tracker]   # the emulated tracker, written by tepm hw emulate
kind = "openigtlink"
host = "127.0.0.1"
port = {port}
devices = [{devices}]
latency_s = {latency}
"""


def emulate(
    out: Annotated[Path, typer.Option("--out", help="Folder for the serial port and the robot file.")] = Path("bench"),
    robot: RobotOption = None,
    rig: Annotated[str, typer.Option("--rig", help="Rig file of the arm, or a built-in one.")] = "virtual_prototype",
    port: Annotated[int, typer.Option("--tracker-port", min=1024, max=65535, help="Port of the OpenIGTLink server.")] = 18944,
) -> int:
    """A board, an arm and a tracker that are not there, in real time until Ctrl-C.

    The board speaks the protocol of the firmware and keeps the host's rules, but is not the firmware.
    """
    from tepm_opt.hw.emulation.bench import EmulatedBench
    from tepm_opt.hw.simulation.rig import SimulatedRig
    from tepm_opt.hw.simulation.rigfile import builtin_rigs, load_rig_file
    from tepm_opt.hw.simulation.scaling import fitted
    from tepm_opt.models.robot import load_robot

    file, found = load_rig_file(rig), load_robot(robot or "kang2017")
    if rig in builtin_rigs():
        file = fitted(file, found)
    elif robot:
        raise InputError(f"--robot {robot}: rig {rig} names its robot itself; leave the option out, or take a built-in rig")
    text = _robot_file(str(robot or file.robot), port, len(SimulatedRig(file).layout.point_names), file.tracker.latency_s)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made ({error.strerror}); name another folder") from error
    written = out / "robot.toml"
    if written.exists() and written.read_text(encoding="utf-8") != text:
        raise InputError(f"{written} exists and is another robot file; name another folder")
    written.write_text(text, encoding="utf-8")
    link = load_robot(written).hardware
    if link is None or link.tracker is None:
        raise InputError(f"{written}: it has no [hardware.tracker]; valid: a robot file with [hardware]")
    with EmulatedBench(SimulatedRig(file, watched=False), out / "port", link.tracker) as bench:
        say(f"board at {out / 'port'}, tracker at 127.0.0.1:{link.tracker.port}, robot file {written}; Ctrl-C ends it", "bold")
        say(f"Try it: tepm hw check {out / 'port'} --robot {written}")
        say(f"        tepm mpc circle --rig serial:{out / 'port'} --robot {written} --out loop")
        try:
            with stopped_by_signals():
                bench.run(lambda: False)
        except KeyboardInterrupt:
            say("ended")
    return SOLVED


def _robot_file(robot: str, port: int, points: int, latency: float) -> str:
    """Text of the robot's file with the emulated tracker in it, unless it names a tracker itself."""
    from tepm_opt.models.robot import builtin_robots, load_robot, robot_text

    text = robot_text(robot) if robot in builtin_robots() else Path(robot).read_text(encoding="utf-8")
    hardware = load_robot(robot).hardware
    if hardware is not None and hardware.tracker is not None:
        if hardware.tracker.kind != "openigtlink":
            raise InputError(f"robot {robot}: its tracker is of the kind {hardware.tracker.kind!r}; valid: openigtlink, or no tracker")
        return text
    devices = ", ".join(f'"S{number}ToTracker"' for number in range(1, points + 1))
    return text.rstrip("\n") + "\n" + TABLE.format(port=port, devices=devices, latency=latency)
