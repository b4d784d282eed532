"""Data sets of machines that others measured, for `tepm discrepancy OUT --plant examples/MACHINE.py`.

python examples/measured.py MACHINE SHARED_FOLDER OUT
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import measured_arm
import measured_bouc_wen
import measured_emps
import measured_silverbox
import measured_tanks
import measured_tentacle
import measured_trunk

PREPARED: dict[str, Callable[[Path, Path], None]] = {
    "bouc_wen": measured_bouc_wen.bouc_wen,
    "cascaded_tanks": measured_tanks.tanks,
    "emps": measured_emps.emps,
    "emps_tip_force": measured_emps.emps_tip_force,
    "emps_guide": measured_emps.emps_guide,
    "pneumatic_arm": measured_arm.steps,
    "pneumatic_arm_gauges": measured_arm.steps_by_gauges,
    "pneumatic_arm_contact": measured_arm.contact,
    "silverbox": measured_silverbox.silverbox,
    "tentacle": measured_tentacle.tentacle,
    "trunk_0g": measured_trunk.payload(0),
    "trunk_100g": measured_trunk.payload(100),
    "trunk_300g": measured_trunk.payload(300),
}
"""By name: what writes the data set of a machine from a folder of measurements into a folder."""


if __name__ == "__main__":
    if len(sys.argv) != 4 or sys.argv[1] not in PREPARED:
        sys.exit(f"{__doc__}\nvalid machines: {', '.join(PREPARED)}")
    try:
        PREPARED[sys.argv[1]](Path(sys.argv[2]), Path(sys.argv[3]))
    except OSError as error:
        sys.exit(str(error))
