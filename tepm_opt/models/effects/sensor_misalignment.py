"""A tracker frame that is not where it is taken to be."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.effects.rotations import rotation


class SensorMisalignment(Effect):
    """Measured points are the true ones turned about the origin of G (by z about z, then y about y, then x about x) and shifted."""

    name = "sensor_misalignment"
    explains = "tracker frame rotated or shifted against the assumed G"
    exact = True
    reference = "Horn, Closed-form solution of absolute orientation using unit quaternions, JOSA A 4 (1987)"
    parameters = (
        *(Parameter(f"rotation_{axis}", "rad", null=0.0, probe=0.01, low=-0.5, high=0.5) for axis in "xyz"),
        *(Parameter(f"shift_{axis}", "m", null=0.0, probe=1e-3, low=-1.0, high=1.0) for axis in "xyz"),
    )

    def outputs(self, points: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        turn, shift = ([parameters[f"{part}_{axis}"] for axis in "xyz"] for part in ("rotation", "shift"))
        return rotation(*turn) @ points + ca.repmat(ca.vertcat(*shift), 1, context.layout.points)
