"""What each effect does to the robot, against closed forms; the contract all effects share is in test_effect_contract.py."""

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.models.effects import effects, find_effect, register
from tepm_opt.models.effects.payload import Payload
from tepm_opt.models.model import Model
from tepm_opt.solvers.modes import poles
from tepm_opt.solvers.statics import solve_statics
from tests.tools import random_inputs

NOMINAL = Model.of("kang2017")


def test_a_payload_is_a_weight_on_the_tip(kang):
    loaded = compile_model(NOMINAL.with_effect("payload", mass=0.03))
    for u in random_inputs(kang, 3, 0):
        found = solve_statics(loaded, u, [0.2, 0.0, 0.1])
        expected = solve_statics(kang, u, [0.2, 0.0, 0.1 - 0.03 * 9.81])
        assert abs(found.points - expected.points).max() < 1e-12


def test_a_payload_is_inertia_too(kang):
    """Sway slows down more than by the weight alone, which a force on the tip takes away again."""
    loaded = compile_model(NOMINAL.with_effect("payload", mass=0.03))
    with_mass = abs(poles(solve_statics(loaded, np.zeros(12), [0, 0, 0.03 * 9.81]))[0])
    without = abs(poles(solve_statics(kang, np.zeros(12)))[0])
    assert 0.75 < with_mass / without < 0.95


def test_a_dead_zone_takes_the_threshold_off_the_pressure(kang):
    model = compile_model(NOMINAL.with_effect("pressure_dead_zone", threshold=2e4))
    u = np.array([0, 1.5e4, 1.6e4, 2e4, 2.4e4, 2e5, 0, 1, 2, 3, 4, 5])
    effective = model.chain.actuation(u, model.theta)
    np.testing.assert_allclose(effective[[0, 1, 2, 4, 5]], [0, 0, 0, 4e3, 1.8e5], atol=1e-9)
    assert 0 < effective[3] <= 0.2 * 2e4 / 4  # in the rounded corner
    np.testing.assert_array_equal(effective[6:], u[6:])
    found = solve_statics(model, u)
    expected = solve_statics(kang, effective)
    assert abs(found.points - expected.points).max() < 1e-12


def test_a_dead_zones_corner_is_smooth():
    """Value and slope of the effective pressure are continuous where the parabola meets its lines."""
    model = compile_model(NOMINAL.with_effect("pressure_dead_zone", threshold=2e4))
    pressures = np.array([1.6e4, 2.4e4])
    for p in pressures:
        below, at, above = (model.chain.actuation(np.array([p + d] + [0.0] * 11), model.theta)[0] for d in (-1.0, 0.0, 1.0))
        assert above - at == pytest.approx(at - below, abs=1e-3)


def test_names_are_looked_up_and_taken_once():
    names = [effect.name for effect in effects()]
    assert names == sorted(names)
    assert find_effect("payload").name == "payload"
    assert not {"gravity", "known_loads"} & set(names)  # part of every model
    with pytest.raises(InputError, match=r"file\.toml: unknown effect 'payloads': did you mean 'payload'"):
        find_effect("payloads", "file.toml")
    with pytest.raises(InputError, match="effect 'payload' exists already"):
        register(Payload())
