"""Answers that a compiled model gives.

Rooms: `mechanics` (equilibrium, motion, predictions of runs), `kinematics` (tip to set points), `linear` (gain, state space, modes),
`identification` (parameters from runs), `planning` (paths and motions) and, below them, `numerics`.
"""

from __future__ import annotations

from tepm_opt.renamed import rename_modules

rename_modules(
    __name__,
    {
        "statics": "mechanics.statics",
        "simulate": "mechanics.simulate",
        "predict": "mechanics.predict",
        "plant": "mechanics.plant",
        "network_plant": "mechanics.network_plant",
        "ik_problem": "kinematics.ik_problem",
        "nearest": "kinematics.nearest",
        "allocation": "kinematics.allocation",
        "constant_curvature": "kinematics.constant_curvature",
        "backbone": "kinematics.backbone",
        "gain": "linear.gain",
        "modes": "linear.modes",
        "modal_model": "linear.modal_model",
        "reduction": "linear.reduction",
        "identify": "identification.identify",
        "problem": "identification.problem",
        "residuals": "identification.residuals",
        "prior": "identification.prior",
        "uncertainty": "identification.uncertainty",
        "hierarchy": "identification.hierarchy",
        "start": "identification.initial_state",
        "trajectories": "planning.trajectories",
        "sized": "planning.scaled_paths",
        "least_squares": "numerics.least_squares",
        "parallel": "numerics.parallel",
        "text": "numerics.text",
    },
)
