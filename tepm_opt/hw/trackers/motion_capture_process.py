"""The process in which motioncapture runs: a program of its own, `motion_capture_process.py DESCRIPTOR SYSTEM SETTINGS`.

`motioncapture.connect` holds Python's lock and, as `waitForNextFrame`, waits for ever where nobody answers: in the host's process it would
stop the controller. Here the kernel's alarm ends the process, whatever the library does meanwhile.
"""

from __future__ import annotations

import importlib
import json
import signal
import sys
import time
from multiprocessing.connection import Connection

ANSWER_S, REFUSED_S = 2.0, 0.5
"""Longest time that a server may take to connect, and between two frames; pause after a refusal, so that attempts cost little."""


def main(descriptor: int, system: str, settings: dict[str, str]) -> None:
    """Send frames until a server falls silent or the reader goes away.

    First comes "" once connected, or why not; then for each frame its arrival on the monotonic clock in s and for each body, by name,
    x, y, z in m and a quaternion x, y, z, w.

    Args:
        descriptor: of the pipe to write to.
        system: as motioncapture names it.
        settings: of its connection.
    """
    motioncapture = importlib.import_module("motioncapture")
    line = Connection(descriptor, readable=False)
    signal.setitimer(signal.ITIMER_REAL, ANSWER_S)  # nobody handles its signal, so it ends the process
    try:
        source = motioncapture.connect(system, settings)
    except Exception as error:  # whatever the library raises where nobody is there
        time.sleep(REFUSED_S)
        line.send(str(error) or type(error).__name__)
        return
    line.send("")
    while True:
        signal.setitimer(signal.ITIMER_REAL, ANSWER_S)
        source.waitForNextFrame()
        arrival, bodies = time.monotonic(), {}
        for name, body in source.rigidBodies.items():
            turn = body.rotation
            bodies[name] = (*map(float, body.position), turn.x, turn.y, turn.z, turn.w)
        line.send((arrival, bodies))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], json.loads(sys.argv[3]))
