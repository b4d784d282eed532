"""Closed loops on any rig: what reads samples and gives commands.

Rooms: `references` (what is followed), `estimation`, `actuation`, `mpc`, `collision`, `diagnostics` (faults while a loop runs) and
`baselines` (controllers to compare with). `controller` says what a controller is, `loop` closes it.
"""

from __future__ import annotations

from tepm_opt.renamed import rename_modules

rename_modules(
    __name__,
    {
        "actuators": "actuation.actuators",
        "pressure_planner": "actuation.pressure_planner",
        "estimator": "estimation.kalman_filter",
        "friction": "estimation.dahl_friction",
        "lengths": "estimation.lengths",
        "reference": "references.reference",
        "contour": "references.path_following",
        "timing": "references.time_optimal",
        "learning": "references.iterative_learning",
        "mpc_settings": "mpc.settings",
        "forecast": "mpc.prediction",
        "qp": "mpc.qp",
        "keep_out": "collision.model",
        "obstacles": "collision.geometry",
        "detour": "collision.elastic_band",
        "doubts": "diagnostics.sensors",
        "markers": "diagnostics.marker_slip",
        "change": "diagnostics.change_detection",
        "monitor": "diagnostics.monitor",
        "pid": "baselines.pid",
        "length_control": "baselines.length_control",
        "controllers.base": "controller",
        "controllers.mpc": "mpc.controller",
        "controllers.lqg": "baselines.lqg",
        "controllers.modes": "baselines.modes",
    },
)
