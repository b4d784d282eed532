"""G, 3 x 12: ours, derivatives through CasADi's root finders, differences of solves."""

from __future__ import annotations

import casadi as ca
import numpy as np

from benchmarks.goals import faster, near_limit
from benchmarks.parts import Session
from benchmarks.scene import Scene, free
from benchmarks.timing import Contender, Task
from benchmarks.workshop import Buffered
from tepm_opt.solvers.linear.gain import solve_gain

OURS = "tepm_opt solve_gain"
AD_C = "AD through fast_newton, generated C"
AD_INTERPRETED = "AD through fast_newton, virtual machine"
PART = 1e-4  # of an input's range, the step of differences


def _through(name: str, rootfinder: ca.Function, scene: Scene) -> ca.Function:
    """Function (start, u) → d tip/du, by CasADi's choice of forward or reverse mode."""
    start, u = ca.MX.sym("start", scene.network.x.numel()), ca.MX.sym("u", scene.model.layout.inputs)
    half = u.numel() // 2
    force = scene.model.model.values["A"] * u[:half] - u[half:]
    return ca.Function(name, [start, u], [ca.jacobian(scene.tip(rootfinder(start, force)), u)])


GOALS = (
    faster("gain", "G, 3 x 12", 15, AD_C),
    faster("gain", "G, 3 x 12", 15, AD_INTERPRETED),
    near_limit("gain", "G, 3 x 12", 3),
)


def tasks(session: Session) -> list[Task]:
    """At the operating point, from its solution; the answer is G with columns scaled by their input's range."""
    scene, peers, workshop = session.scene, session.peers, session.workshop
    at, u, span = free(scene.bent), scene.bent.inputs, scene.model.input_max
    compiled = workshop.external(_through("gain_compiled", peers.fast_on_c, scene), peers.objects)
    interpreted = _through("gain_interpreted", peers.fast_interpreted, scene)
    plain = _through("gain_plain", peers.plain, scene)

    tip = Buffered(scene.tip)

    def differences() -> np.ndarray:
        columns = []
        for k, step in enumerate(PART * span):
            change = np.zeros(len(span))
            change[k] = step
            ends = [tip(peers.fast(at, scene.forces(u + sign * change))) for sign in (1, -1)]
            columns.append((ends[0] - ends[1]) / (2 * step))
        return np.array(columns).T

    def peer(name: str, function: ca.Function) -> Contender:
        buffered = Buffered(function)
        return Contender(name, lambda: buffered(at, u), lambda found: found.reshape(-1, 3).T * span)

    contenders = [
        Contender(OURS, lambda: solve_gain(scene.bent), lambda found: found.normalise(), ours=True),
        peer(AD_C, compiled),
        Contender(f"{AD_C}, plain call", lambda: compiled(at, u), lambda found: found.full() * span),
        peer(AD_INTERPRETED, interpreted),
        peer("AD through newton, virtual machine", plain),
        Contender("central differences, 24 fast_newton solves", differences, lambda found: found * span),
    ]
    expected = solve_gain(scene.bent).normalise()
    return [Task("gain", "G, 3 x 12, at 0.15 MPa in p_11 and p_21", expected, contenders)]
