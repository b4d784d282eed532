"""Single checks of computer, board and tracker: what was seen, whether it is right, and what to do next. None of them moves anything."""

from __future__ import annotations

import shutil
import sys
from dataclasses import dataclass
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median

import numpy as np

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.hw.board.errors import LinkError
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.protocol import ResetCause
from tepm_opt.hw.board.status import BoardStatus, Hello
from tepm_opt.hw.trackers import Tracker
from tepm_opt.models.hardware import COUNTS_PER_V

FIRMWARE = Path(protocol.__file__).parent.parent / "firmware"
PACKAGES = ("numpy", "pyserial", "cobs", "pyigtl", "platformdirs")
TOOLS = {"make": "make", "avr-gcc": "gcc-avr avr-libc arduino-core-avr", "avrdude": "avrdude"}
"""Programs that flash the firmware, and Debian's packages with them."""
ALIVE = (0.25, 4.75)
"""Volts of a dynamometer that is neither open nor shorted, as in the firmware's `config.h`."""
SLACK_N, NO_PRESSURE_PA = 0.2, 20e3
"""Largest readings of a dynamometer without tension and of a monitor without pressure."""
LISTEN_S, FEWEST_HZ, WORST_SHARE = 2.0, 50.0, 0.01
"""Seconds for which the line is listened to; least STATUS a second, and largest share of them lost or damaged, of a good one."""


class Mark(Enum):
    """Result of a check: right, wrong, or not (yet) to be said."""

    RIGHT = "✓"
    WRONG = "✗"
    OPEN = "–"


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        name: what.
        mark: how it ended.
        says: one sentence about it.
        next: what to do about it; empty where nothing.
    """

    name: str
    mark: Mark
    says: str
    next: str = ""


def right(name: str, says: str, next: str = "") -> Check:
    """A check that ended well."""
    return Check(name, Mark.RIGHT, says, next)


def wrong(name: str, says: str, next: str) -> Check:
    """A check that ended badly."""
    return Check(name, Mark.WRONG, says, next)


def not_yet(name: str, says: str, next: str = "") -> Check:
    """A check that could not be made, or need not be."""
    return Check(name, Mark.OPEN, says, next)


def judge(name: str, good: bool, says: str, next: str) -> Check:
    """Make a check that ended well or badly.

    Args:
        name: what was looked at.
        good: how it ended.
        says: one sentence about it.
        next: what to do about it, told only where it ended badly.
    """
    return right(name, says) if good else wrong(name, says, next)


NO_PORT = (
    "plug the board in with a cable that carries data (many only charge); see what the system says (Linux: sudo dmesg | tail); "
    "clones with a CH340 need its driver on Windows and macOS; `tepm hw ports` lists what there is"
)
DIALOUT = "sudo usermod -aG dialout $USER, then log out and in again"
BUSY = "close the other program (another tepm, the Arduino IDE's serial monitor)"


def device_of(port: str) -> str:
    """The device in `PORT` or `PORT@BAUD`."""
    device, at, _ = port.rpartition("@")
    return device if at else port


def flash(port: str | None) -> str:
    """Say in words how to put the firmware on a board."""
    return f"flash the firmware: {flash_command(port)} (BOARD=uno for an Uno)"


def flash_command(port: str | None) -> str:
    """Give the command that puts the firmware on a board."""
    return f"make -C {FIRMWARE} flash PORT={device_of(port or 'PORT')}"


def flash_limits(port: str | None, robot: str) -> str:
    """The commands that put firmware with the limits and calibration of a robot file on a board."""
    return f"tepm hw limits --robot {robot} --out limits.h && {flash_command(port)} LIMITS=$PWD/limits.h"


def packages() -> Check:
    """Whether Python has what the hardware needs."""
    name, found, missing = "python packages", [f"Python {sys.version.split()[0]}"], []
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            missing.append(package)
    return judge(
        name, not missing, f"missing: {', '.join(missing)}." if missing else f"{', '.join(found)}.", f"pip install {' '.join(missing)}"
    )


def tools() -> Check:
    """Whether the firmware can be compiled and flashed here."""
    name, missing = "tools to flash", [tool for tool in TOOLS if shutil.which(tool) is None]
    if not missing:
        return right(name, f"{', '.join(TOOLS)} are here; the firmware is in {FIRMWARE}.")
    install = f"sudo apt install {' '.join(TOOLS[tool] for tool in missing)}"
    return not_yet(name, f"{', '.join(missing)} not installed; needed only to flash the firmware.", install)


def last_reset(hello: Hello) -> Check:
    """Check why the board started last."""
    name, cause = "last reset", hello.reset_cause
    if cause & ResetCause.WATCHDOG:
        return wrong(name, "the watchdog: the firmware hung.", "run this again; if it stays so, flash anew and tell the authors")
    if cause & ResetCause.BROWN_OUT and not cause & ResetCause.POWER_ON:
        return wrong(name, "the supply dipped.", "feed the board from a supply of its own, not from that of motors or valves")
    says = "power-on." if cause & ResetCause.POWER_ON else "opening the port." if cause else "unknown, the boot loader hides it."
    return right(name, says)


def dynamometers(names: tuple[str, ...], counts: tuple[int, ...], calibration: Calibration) -> Check:
    """Whether all dynamometers are connected and show no tension."""
    name, volts = "dynamometers", np.array(counts[: len(names)]) / COUNTS_PER_V
    dead = [f"{at} ({value:.2f} V)" for at, value in zip(names, volts, strict=True) if not ALIVE[0] <= value <= ALIVE[1]]
    if dead:
        zero = np.median(calibration.counts_zero) / COUNTS_PER_V
        hint = f"is it wired and fed? Valid: {ALIVE[0]:g} … {ALIVE[1]:g} V, about {zero:.2f} V slack"
        return wrong(name, f"open or shorted: {', '.join(dead)}.", hint)
    tensions = calibration.tensions(counts)
    loaded = [f"{at} ({value:.2f} N)" for at, value in zip(names, tensions, strict=True) if abs(value) > SLACK_N]
    if loaded:
        return wrong(name, f"not at zero: {', '.join(loaded)}.", "unhook the tendons; if it stays so: tepm hw calibrate tension")
    return right(name, f"all {len(names)} are alive and within {np.abs(tensions).max():.3f} N of zero.")


def monitors(names: tuple[str, ...], counts: tuple[int, ...], calibration: Calibration, hello: Hello) -> Check:
    """Whether all pressure monitors show no pressure.

    Args:
        names: of the actuators.
        counts: of the monitors, (6,).
        calibration: of the robot.
        hello: of the board; an Uno has no pins for monitors.
    """
    name = "pressure monitors"
    if hello.monitors == 0:
        return not_yet(name, "this board has no inputs for them.")
    pressures = calibration.pressures(counts)
    volts = np.array(counts[: len(names)]) / COUNTS_PER_V
    off = [
        f"{at} ({value / 1e3:.0f} kPa, {volt:.2f} V)"
        for at, value, volt in zip(names, pressures, volts, strict=True)
        if abs(value) > NO_PRESSURE_PA
    ]
    hint = "is the air off and let out, is the regulator fed, is its monitor wired? If so: tepm hw calibrate pressure"
    says = f"all {len(names)} are within {np.abs(pressures).max() / 1e3:.1f} kPa of zero (with the air off)."
    return judge(name, not off, f"not at zero: {', '.join(off)}." if off else says, hint)


def line_quality(link: Link) -> Check:
    """Check how good the line is by listening for a while."""
    begin, first = link.statistics.received, last(link)
    lost, bad = link.statistics.lost, link.statistics.bad
    link.wait(lambda: last(link).time - first.time >= LISTEN_S, LISTEN_S + 1.0)
    seconds = last(link).time - first.time
    received = link.statistics.received - begin
    lost, bad = link.statistics.lost - lost, link.statistics.bad - bad
    rate = received / seconds if seconds > 0 else 0.0
    good = rate >= FEWEST_HZ and lost + bad <= WORST_SHARE * received
    says = f"{rate:.0f} STATUS a second over {max(seconds, LISTEN_S):.0f} s, {lost} lost, {bad} damaged."
    return judge("line", good, says, "shorter USB cable, no hub, away from the motors' cables; is this computer very busy?")


def sensors(tracker: Tracker, names: tuple[str, ...]) -> Check:
    """Check which sensors are seen, and how old their poses are."""
    name, frames = "tracker's sensors", []
    while len(frames) < 40 and (frame := tracker.read(0.5)) is not None:
        frames.append(frame)
    if not frames:
        return wrong(name, "no poses come any more.", "see to PlusServer")
    if frames[0].points.shape[0] != len(names):
        return wrong(name, f"{len(frames[0].points)} devices for {len(names)} points.", f"name a device for each of {', '.join(names)}")
    seen = np.isfinite([frame.points for frame in frames]).all(axis=2).mean(axis=0)
    age = median(frame.age for frame in frames)
    lost = [f"{at} ({share:.0%} of the time)" for at, share in zip(names, seen, strict=True) if share < 0.9]
    says = f"hardly seen: {', '.join(lost)}." if lost else f"{', '.join(names)} are seen, poses are {1e3 * age:.0f} ms old."
    return judge(name, not lost, says, "is the sensor plugged in and near the transmitter?")


def last(link: Link) -> BoardStatus:
    """The last STATUS.

    Raises:
        LinkError: there is none.
    """
    if link.status is None:
        raise LinkError("the board has not told its state yet")
    return link.status
