"""Robot, operating points and the answers that every contender has to find."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.network import WholeNetwork, write_whole_network
from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_statics


@dataclass(frozen=True)
class Scene:
    """What the tasks share.

    Attributes:
        model: ours, compiled C.
        network: the peers' network.
        rest: equilibrium without inputs.
        bent: at p_11 = p_21 = 0.15 MPa.
        nudged: both pressures 1 kPa higher.
        tip: function x → tip in G.
    """

    model: CompiledModel
    network: WholeNetwork
    rest: Equilibrium
    bent: Equilibrium
    nudged: Equilibrium
    tip: ca.Function

    @staticmethod
    def of(robot: str) -> Scene:
        """The scene of a built-in robot.

        Raises:
            InputError: no C compiler, or the two networks disagree about an equilibrium.
        """
        model = compile_model(robot, backend="c")
        network = write_whole_network(model.model)
        pressures = np.zeros(model.layout.inputs)
        pressures[[0, 3]] = 1.0
        rest = solve_statics(model, 0 * pressures)
        bent = solve_statics(model, 0.150e6 * pressures, start=rest)
        nudged = solve_statics(model, 0.151e6 * pressures, start=bent)
        scene = Scene(model, network, rest, bent, nudged, ca.Function("tip", [network.x], [network.tip]))
        residual = ca.Function("residual", [network.x, network.force], [network.residual])
        for equilibrium in (rest, bent, nudged):
            left = float(np.abs(residual(free(equilibrium), scene.forces(equilibrium.inputs)).full()).max())
            if not (equilibrium.solved and left < 1e-8):
                raise InputError(f"ours is no equilibrium of the peers' network: residual {left:.3g} N")
        return scene

    def forces(self, inputs: np.ndarray) -> np.ndarray:
        """Axial forces F_a = p A − λ, Eq. (3)."""
        half = len(inputs) // 2
        return self.model.model.values["A"] * inputs[:half] - inputs[half:]

    def tip_of(self, x: Any) -> np.ndarray:
        """Tip in G, (3,), of the free coordinates a peer found."""
        return self.tip(x).full().ravel()


def free(equilibrium: Equilibrium) -> np.ndarray:
    """Coordinates of the free nodes as the peers order them."""
    return equilibrium.x[1:].ravel()
