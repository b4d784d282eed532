"""Constant disturbances leave no offset at rest, which the tip's bias in the filter promises.

Which of the filter's 42 disturbances can be told? Held still, 12 coordinates say 12 numbers. Six unknown forces act on them through six
independent columns of the static gain; strength, friction and hysteresis act through the same six forces and are told from them only by
how pressures, tensions and directions change: at rest only their sum is observable, which is all that targets at rest need. The biases of
the points add one number to each coordinate; those of all points but the tip fade, so that what does not fade is force, and the tip's own
bias takes what no force explains. The pair is then observable in the tip, which is what offset-freeness takes (Pannocchia and Rawlings,
AIChE J. 49, 2003: as many disturbances as outputs that shall be free of offset).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from tepm_opt.control.estimation.kalman_filter import DiscreteModalModel, Estimator
from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.reference import Reference, approach, reference_of
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import load_rig_file
from tepm_opt.solvers.linear.modal_model import modal_model
from tepm_opt.solvers.planning.trajectories import circle
from tests.control.study import APPROACH, WIDE, model

MOST = 2.5e-4  # m; 0.204 mm when written
SETTLED = 4.0  # s after which it is at rest


@lru_cache(maxsize=1)
def held() -> Reference:
    """From rest to the circle's first point, and there for 24 s: what noise does to the tip in the mean is small then."""
    lead = approach(model(), circle().positions[0], APPROACH)
    return reference_of(model(), np.vstack([lead, np.repeat(circle().positions[:1], 2400, axis=0)]))


def at_rest(seed: int) -> float:
    """Distance in m of the true tip's mean from its target over the last 20 s."""
    random = np.random.default_rng([seed, 8])
    file = load_rig_file()
    found = file.imperfections
    tilt = found.base_tilt.model_copy(update={"rotation_deg": tuple(random.uniform(-1, 1, 2))})
    gain = found.actuator_gain.model_copy(update={"loss": {name: float(random.uniform(-0.1, 0.1)) for name in found.actuator_gain.loss}})
    changed = found.model_copy(update={"base_tilt": tilt, "actuator_gain": gain})
    rig = SimulatedRig(file.model_copy(update={"imperfections": changed}))
    rig.reseed(seed)
    rig.push(0.1 * random.normal(size=3))
    path = held()
    done = close_loop(rig, Mpc(model(), path), model().robot, WIDE)
    error = (np.array(done.truth) - done.targets)[np.array(done.time) > APPROACH + SETTLED]
    return float(np.linalg.norm(error.mean(axis=0)))


@pytest.mark.slow
def test_constant_disturbances_leave_no_offset_at_rest() -> None:
    """Ten of them: a force on the tip, strengths of all muscles, a tilt of the base, beside all that the prototype has."""
    offsets = [at_rest(seed) for seed in range(1, 11)]
    print(np.round(1e3 * np.array(offsets), 3))
    assert np.mean(offsets) < MOST


def test_the_tip_at_rest_sees_forces_and_bias(short: Reference) -> None:
    """The filter's own matrices, at rest: the observable part takes in everything that moves the tip's mean."""
    operating = DiscreteModalModel.from_modal_model(modal_model(short.equilibria[330]), short.forces[330], short.period)
    filtered = Estimator(operating, 6e-4, 3.5)
    done = filtered.predict(np.tile(operating.forces, (2, 1)), np.full(6, 3.5), np.zeros(6), operating)
    states, modes = len(filtered.mean), len(operating.model.stiffness)
    C = np.zeros((len(operating.model.observe), states))
    C[:, :modes] = operating.model.observe
    C[:, -len(C) :] = np.eye(len(C))
    seen, step = [C], C
    for _ in range(60):
        step = step @ np.linalg.matrix_power(done.A, 5)
        seen.append(step)
    _, sizes, turns = np.linalg.svd(np.vstack(seen))
    kept = turns[sizes > 1e-9 * sizes[0]]
    forces, tip = slice(2 * modes, 2 * modes + 6), slice(states - 3, states)
    for part in (forces, tip):
        unit = np.eye(states)[part]
        np.testing.assert_allclose(unit @ kept.T @ kept, unit, atol=1e-3)
