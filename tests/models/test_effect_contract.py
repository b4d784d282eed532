"""The contract every effect passes: null identity, derivatives, recovery of its own parameters, potentials and passivity.

A new effect is tested without a line here. Four made-up ones stand for those of third parties. Every day each effect is tested in company:
in one model that has all the others at their null values. Alone, in a model of its own that takes seconds to compile, it is slow.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import least_squares

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.effect import ActiveEffect, Effect, Parameter
from tepm_opt.models.effects import _registry, effects, find_effect, register
from tepm_opt.models.layout import VERTICAL, Layout
from tepm_opt.models.memories import Lag, Memory
from tepm_opt.models.model import Model, read_model, write_model
from tepm_opt.solvers.linear.gain import solve_gain
from tepm_opt.solvers.mechanics.simulate import Directions, simulate
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_statics
from tepm_opt.solvers.numerics.matrices import expand_band
from tests.independent import solve_with_effect
from tests.models.laws import written
from tests.tools import PRECISE, observed, one_sided_slope, random_directions, random_inputs, relative, slope, with_all_effects, with_effect

STATIC_HOOKS = ("inputs", "properties", "loads", "edge_energy", "tendon_energy", "outputs")
MOTION_HOOKS = ("pressure_memory", "tension_memory", "edge_memory", "edge_drag", "point_drag", "delay")
NOMINAL = Model.from_robot("kang2017")
LAYOUT = Layout.from_robot(NOMINAL.robot)
AT_REST, IN_MOTION = 12.33, 9.0  # s, times in the session for effects that ask: of statics, and when motions begin


class ToyHardening(Effect):
    """A third party's potential: muscles stiffen with stretch."""

    name = "toy_hardening"
    explains = "vertical edges that stiffen with stretch"
    reference = "made up for this test"
    parameters = (Parameter("cubic", "N/m^3", null=0.0, probe=1e6, low=0.0),)

    def edge_energy(self, edge, length, rest, parameters, context):
        return parameters["cubic"] * (length - rest) ** 4 / 4 if edge.kind == VERTICAL else 0 * length


class ToyStiffening(Effect):
    """A third party's property that the inputs drive: muscles are stiffer under pressure."""

    name = "toy_stiffening"
    explains = "vertical edges that are stiffer under pressure"
    reference = "made up for this test"
    parameters = (Parameter("per_pressure", "1/Pa", null=0.0, probe=2e-7, low=0.0, high=1e-3),)

    def properties(self, properties, parameters, context):
        layout = context.layout
        for segment in range(layout.levels):
            for j in range(layout.actuators):
                pressure = properties.pressure[segment // layout.segments, j]
                properties.stiffness[j, segment] *= 1 + parameters["per_pressure"] * pressure


class ToyHolder(Effect):
    """A third party's output map, with a detail and two parameters: a marker sits off its point."""

    name = "toy_holder"
    explains = "a reference point's marker sits elsewhere"
    reference = "made up for this test"
    parameters = (Parameter("along_x", "m", 0.0, 1e-3, -0.1, 0.1), Parameter("along_y", "m", 0.0, -2e-3, -0.1, 0.1))
    detail = "point"

    def outputs(self, points, parameters, context):
        column = ca.DM(np.eye(context.layout.points)[[context.detail]])
        return points + ca.vertcat(parameters["along_x"], parameters["along_y"], 0) @ column


class ToyValve(Effect):
    """A third party's lag, whose name and parameters nobody knows: pressures lag alike on the way up and down."""

    name = "toy_valve"
    explains = "valves that take time"
    reference = "made up for this test"
    parameters = (Parameter("slowness", "s", null=0.0, probe=0.04, low=0.0, high=1.0),)

    def lag(self, parameters):
        return Lag(parameters["slowness"], parameters["slowness"])

    def pressure_memory(self, pressure, rate, state, parameters, context):
        return Memory(-rate, ca.SX.ones(*state.shape), parameters["slowness"] * ca.SX.ones(*state.shape))


TOYS = (ToyHardening(), ToyStiffening(), ToyHolder(), ToyValve(), *written())


@dataclass(frozen=True)
class Subject:
    """An effect in a compiled model in which all others, if there are any, have their null values.

    Attributes:
        effect: the one to test.
        active: how it is in the model.
        compiled: the model with the effect at its probe values.
    """

    effect: Effect
    active: ActiveEffect
    compiled: CompiledModel

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters in this robot."""
        return self.effect.parameters_of(self.compiled.layout)

    @property
    def own(self) -> dict[Parameter, int]:
        """Its parameters' places in theta."""
        return {p: self.compiled.network.parameter_names.index(f"{self.active.label}.{p.name}") for p in self.parameters}

    def at(self, values: dict[Parameter, float]) -> CompiledModel:
        """The compiled model with other values of the effect's parameters."""
        theta = self.compiled.theta.copy()
        for parameter, value in values.items():
            theta[self.own[parameter]] = value
        return self.compiled.with_theta(theta)

    @property
    def null(self) -> CompiledModel:
        return self.at({p: p.null for p in self.parameters})

    @property
    def detail(self) -> int | None:
        """Number of the actuator or point the effect acts on."""
        names = self.compiled.layout.details(self.effect.detail)
        return names.index(self.active.detail) if names else None


def each(chosen: Iterable[Effect], slow: Collection[Effect] = ()) -> list:
    """Parameters of `subject_of`: effects in company, some of which are slow, then alone."""
    chosen = list(chosen)
    company = [pytest.param((effect, False), id=effect.name, marks=pytest.mark.slow if effect in slow else ()) for effect in chosen]
    alone = [pytest.param((effect, True), id=f"{effect.name} alone", marks=pytest.mark.slow) for effect in chosen]
    return [*company, *alone]


def overrides(effect: Effect, hooks: tuple[str, ...]) -> bool:
    return any(effect.has(hook) for hook in hooks)


def with_effects(chosen: Iterable[Effect]) -> Model:
    """The nominal robot with these effects at their probe values."""
    model = NOMINAL
    for effect in chosen:
        model = with_effect(model, effect)
    return model


ALL = (*effects(), *TOYS)
STATIC = [effect for effect in ALL if overrides(effect, STATIC_HOOKS) and not effect.has("delay")]  # what comes late shows in motion
MOVING = [effect for effect in ALL if overrides(effect, MOTION_HOOKS)]
EVERYDAY = [effect for effect in MOVING if effect not in TOYS][::2]
"""Effects whose motions are tested every day, in company of each other."""


@pytest.fixture(scope="module")
def subject_of():
    """The subject of an effect, alone or in company: of those of the package, or of those made up."""
    everything = with_all_effects(NOMINAL)  # compiled for many tests, without what is made up
    for toy in TOYS:
        register(toy)

    @cache
    def compiled(group: str) -> CompiledModel:
        return compile_model({"everyday": with_effects(EVERYDAY), "made up": with_effects(TOYS), "all": everything}[group])

    def company(effect: Effect) -> CompiledModel:
        """All effects of the package, or those made up; `EVERYDAY` alone, whose motions compile in a third of the time."""
        return compiled("everyday" if effect in EVERYDAY else "made up" if effect in TOYS else "all")

    @cache
    def subject_of(effect: Effect, alone: bool) -> Subject:
        if alone:
            compiled = compile_model(with_effect(NOMINAL, effect)).at_time(AT_REST)
            return Subject(effect, compiled.model.effects[0], compiled)
        compiled = company(effect)
        theta = compiled.theta.copy()
        for other in compiled.model.effects:
            for parameter in find_effect(other.name).parameters_of(compiled.layout) if other.name != effect.name else ():
                theta[compiled.network.parameter_names.index(f"{other.label}.{parameter.name}")] = parameter.null
        active = next(each for each in compiled.model.effects if each.name == effect.name)
        return Subject(effect, active, compiled.with_theta(theta).at_time(AT_REST))

    yield subject_of
    for toy in TOYS:
        del _registry()[toy.name]


@pytest.fixture(scope="module", params=each(ALL))
def subject(request, subject_of):
    return subject_of(*request.param)


@pytest.fixture(scope="module", params=each(STATIC))
def static(request, subject_of):
    """Effects that show at rest."""
    return subject_of(*request.param)


@pytest.fixture(scope="module", params=each(effect for effect in STATIC if effect.smooth))
def smooth(request, subject_of):
    """Effects that show at rest and have derivatives at their null values."""
    return subject_of(*request.param)


@pytest.fixture(scope="module", params=each(MOVING, slow=[effect for effect in MOVING if effect not in EVERYDAY]))
def moving(request, subject_of):
    """Effects that show in motion only: every day each second one."""
    return subject_of(*request.param)


@pytest.fixture(scope="module", params=each(ALL, slow=[effect for effect in ALL if effect not in EVERYDAY]))
def driven(request, subject_of):
    """Effects whose part in a motion is tested: every day those of `EVERYDAY`."""
    return subject_of(*request.param)


@pytest.fixture(scope="module", params=[*each([ALL[0], EVERYDAY[0], TOYS[0]])[:3], *each(ALL)[len(ALL) :]])
def null(request, subject_of):
    """Models with all effects, or one, at their null values: the effects in company have the same one."""
    return subject_of(*request.param).null


@pytest.fixture(scope="module")
def excitation(kang):
    """Set points that move and reverse everything so gently that no step is halved, with a rest at the end; tendons are nearly let go."""
    time = np.linspace(0, 2.0, 101)
    rng, active = np.random.default_rng(11), np.clip(time, 0, 1.6)
    waves = 0.5 - 0.5 * np.cos(np.outer(2 * np.pi * active / 1.6, rng.integers(1, 3, 12)))
    force = 0.05 * np.column_stack([np.sin(4 * active), np.cos(3 * active), 0 * time])
    points = SetPoints(time, (np.repeat([0.1, 0.004], 6) + 0.1 * waves) * kang.input_max, force)
    assert simulate(kang, points, step=0.01).complete().effort.halvings == 0
    return points


@pytest.fixture(scope="module")
def operating(kang):
    """15 operating points: inputs and tip forces."""
    return list(zip(random_inputs(kang, 15, 7, 0.1, 0.9), 0.5 * random_directions(15, 8), strict=True))


@pytest.fixture(scope="module")
def gentle(kang):
    """Operating points with so little of everything that corners show."""
    return [(u, np.zeros(3)) for u in random_inputs(kang, 5, 9, 0.0, 0.03)]


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: effect.name)
def test_metadata_is_complete(effect):
    assert effect.name.isidentifier()
    assert effect.name == effect.name.lower()
    assert effect.explains
    assert effect.reference
    assert effect.detail in (None, "actuator", "point")
    own = effect.parameters_of(LAYOUT)
    assert own
    for parameter in own:
        assert parameter.name.isidentifier()
        assert parameter.unit
        assert parameter.low <= parameter.null <= parameter.high
        assert parameter.low <= parameter.probe <= parameter.high
        assert parameter.scale > 0
    assert any(not parameter.is_shape for parameter in own)


def test_at_its_null_values_it_vanishes(null, kang, operating):
    for u, force in operating[:5]:
        found, plain = solve_statics(null, u, force), solve_statics(kang, u, force)
        assert abs(observed(found) - observed(plain)).max() < 1e-12
        G, G_plain = solve_gain(found), solve_gain(plain)
        assert relative(G.normalise(), G_plain.normalise()) < 1e-10
        assert relative(G.by_load, G_plain.by_load) < 1e-10


def test_its_probe_is_visible(static, kang, operating):
    moved = [abs(solve_statics(static.compiled, u, f).points - solve_statics(kang, u, f).points).max() for u, f in operating[:5]]
    assert max(moved) > 5e-5


def derivatives(model: CompiledModel, held: Equilibrium) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of points and lengths by inputs (in parts of their ranges), tip force and parameters."""
    weights = np.eye(len(observed(held)))
    status, by_u, by_load, by_theta = model.statics.sensitivity(held.x, held.load_case, weights, True)
    assert status == 0
    return by_u * model.input_max, by_load[:, -3:], by_theta


@pytest.mark.parametrize("number", [0, 1, 2])
def test_derivatives_by_inputs_and_loads(static, operating, number):
    model, (u, force) = static.compiled, operating[number]
    held = solve_statics(model, u, force, settings=PRECISE)
    by_u, by_load, _ = derivatives(model, held)
    half = len(u) // 2

    def moved(parts, change):
        return observed(solve_statics(model, u + parts * model.input_max, force + change, held, PRECISE))

    u_slopes = np.stack([slope(lambda h: moved(h * part, np.zeros(3)), 1e-3) for part in np.eye(len(u))], axis=1)  # noqa: B023
    load_slopes = np.stack([slope(lambda h: moved(0, h * axis), 1e-3) for axis in np.eye(3)], axis=1)  # noqa: B023
    for found, expected in ((by_u[:, :half], u_slopes[:, :half]), (by_u[:, half:], u_slopes[:, half:]), (by_load, load_slopes)):
        assert relative(found, expected) < 1e-5


@pytest.mark.parametrize("number", [0, 1, 2])
def test_derivatives_by_its_parameters(static, operating, number):
    u, force = operating[number]
    for parameter, at in static.own.items():
        held = solve_statics(static.compiled, u, force, settings=PRECISE)
        found = derivatives(static.compiled, held)[2][:, at]

        def changed(h, parameter=parameter, held=held):
            return observed(solve_statics(static.at({parameter: parameter.probe + h}), u, force, held, PRECISE))

        expected = slope(changed, 0.01 * parameter.scale)
        assert np.linalg.norm(found - expected) <= 1e-5 * np.linalg.norm(expected)


def test_derivatives_at_null_agree_with_one_sided_differences(smooth, operating):
    u, force = operating[0]
    held = solve_statics(smooth.null, u, force, settings=PRECISE)
    for parameter, at in smooth.own.items():
        found = derivatives(smooth.null, held)[2][:, at]

        def changed(h, parameter=parameter):
            values = {p: p.null for p in smooth.parameters} | {parameter: parameter.null + h}
            return observed(solve_statics(smooth.at(values), u, force, held, PRECISE))

        expected = one_sided_slope(changed, 0.01 * (parameter.probe - parameter.null or parameter.scale))
        assert np.linalg.norm(found - expected) <= 1e-5 * np.linalg.norm(expected) + 1e-13 / parameter.scale


@pytest.mark.sample(3)
def test_it_recovers_its_own_parameters(static, kang, operating, gentle):
    """Data from the independent network, each at a time of its own; the fit starts at the probe, the truth is half as much again.

    The shape of what goes on in time does not show at rest.
    """
    own, operating = [p for p in static.own if not (static.effect.timed and p.is_shape)], [*operating[:7], *gentle]
    times = AT_REST + 0.7 * np.arange(len(operating))
    probe, size = np.array([p.probe for p in own]), np.array([p.probe - p.null or p.scale for p in own])
    low, high = (np.array([getattr(p, field) for p in own]) for field in ("low", "high"))
    truth = np.clip(probe + 0.5 * size, low, high)
    values = {p.name: p.probe for p in static.own} | dict(zip((p.name for p in own), truth, strict=True))
    data = [
        solve_with_effect(static.effect, values, static.detail, u, f, start=solve_statics(kang, u, f).nodes, time=time)
        for (u, f), time in zip(operating, times, strict=True)
    ]

    def fit(parts):
        model = static.at(dict(zip(own, probe + parts * size, strict=True)))
        return [solve_statics(model.at_time(time), u, f) for (u, f), time in zip(operating, times, strict=True)]

    def residuals(parts):
        held = fit(parts)
        return np.concatenate([(e.points - points).ravel() for e, points in zip(held, data, strict=True)])

    def jacobian(parts):
        held = fit(parts)
        columns = [static.own[p] for p in own]
        return np.concatenate([derivatives(e.model, e)[2][: e.points.size, columns] for e in held]) * size

    bounds = np.sort(((low - probe) / size, (high - probe) / size), axis=0)
    found = least_squares(residuals, np.zeros(len(own)), jacobian, bounds, xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose(found.x, (truth - probe) / size, atol=0.01)
    assert abs(found.fun).max() < 1e-6  # explains the other route's data altogether


def test_forces_come_from_a_potential_and_damping_dissipates(static, operating):
    """Force is the slope of the energy and stiffness, symmetric, that of the force: no cycle of motions gains energy."""
    model, (u, force) = static.compiled, operating[0]
    reference, theta = model.reference, model.theta
    held = solve_statics(model, u, force)
    P, rng = held.properties, np.random.default_rng(0)
    x = held.x.copy()
    x[1:] += rng.normal(scale=1e-3, size=x[1:].shape)
    at = reference.assemble(x, P, theta)
    assert np.isfinite(at.energy)
    for _ in range(3):
        direction = rng.normal(size=x.shape)
        direction[0] = 0
        rise = slope(lambda h: np.array([reference.energy(x + h * direction, P, theta)]), 1e-4)  # noqa: B023
        turn = slope(lambda h: reference.assemble(x + h * direction, P, theta).force.ravel(), 1e-4)  # noqa: B023
        assert rise[0] == pytest.approx(float((at.force * direction[1:]).sum()), rel=1e-7)
        assert relative(expand_band(at.band) @ direction[1:].ravel(), turn) < 1e-7
    damping = np.linalg.eigvalsh(expand_band(reference.assemble_damping(x, P, theta)))
    assert damping[0] > -1e-12 * damping[-1]


@pytest.mark.slow
def test_in_motion_it_vanishes_at_its_null_values(null, kang, excitation):
    begin = SetPoints(excitation.time[:21], excitation.inputs[:21], excitation.tip_force[:21])  # its small steps take long
    for points, settings in ((excitation, {"step": 0.01, "tolerance": 1e-10}), (begin, {"method": "rk4", "step": 3e-4})):
        found, plain = (simulate(model, points, **settings, began=IN_MOTION).complete() for model in (null, kang))
        assert abs(found.points - plain.points).max() < 1e-9


def test_in_motion_its_probe_is_visible(moving, kang, excitation):
    found, plain = (simulate(model, excitation, step=0.01, began=IN_MOTION) for model in (moving.compiled, kang))
    assert abs(found.points - plain.points).max() > 5e-5


@pytest.mark.sample(3)
def test_sensitivities_in_motion(driven, excitation):
    model = driven.compiled
    names = [model.network.parameter_names[at] for at in driven.own.values()]
    found = simulate(
        model, excitation, step=0.01, directions=Directions.from_names(model, names), tolerance=1e-11, began=IN_MOTION
    ).sensitivities
    for (parameter, _), sensitivity in zip(driven.own.items(), found, strict=True):
        size = parameter.scale

        def changed(h, parameter=parameter):
            return simulate(driven.at({parameter: parameter.probe + h}), excitation, step=0.01, tolerance=1e-11, began=IN_MOTION).points

        expected = slope(changed, min(0.02 * size, 1e-5 / max(abs(sensitivity).max(), 1e-12)))
        assert abs(sensitivity - expected).max() <= 1e-5 * abs(expected).max() + 1e-13 / size


def test_in_motion_it_recovers_its_own_parameters(moving, excitation):
    """Data by the other scheme; the fit starts at the probe, the truth is 30 % off, or a small change where the probe is 0.

    What shapes a refinement is half as large, so that it shows in gentle motion.
    """
    own = list(moving.own)
    start = np.array([float(p.probe != 0) for p in own])
    probe = np.array([p.probe or p.scale for p in own])
    truth = np.where([p.finer for p in own], 0.5, np.where(start, 1.3, 1.0)) * probe
    data = simulate(moving.at(dict(zip(own, truth, strict=True))), excitation, "rk4").points
    names = [moving.compiled.network.parameter_names[at] for at in moving.own.values()]
    directions = Directions.from_names(moving.compiled, names)

    def run(parts, **settings):
        return simulate(moving.at(dict(zip(own, parts * probe, strict=True))), excitation, step=0.005, **settings)

    found = least_squares(
        lambda parts: 1e3 * (run(parts).points - data).ravel(),
        start,
        lambda parts: 1e3 * run(parts, directions=directions).sensitivities.reshape(len(own), -1).T * probe,
        x_scale="jac",
    )
    np.testing.assert_allclose(found.x * probe, truth, rtol=0.02)


@pytest.mark.slow
def test_what_it_declares_to_a_controller_vanishes_at_its_null_values(subject):
    effect, still = subject.effect, (None, 0.0, (0.0, 0.0))
    assert (subject.compiled.pressure_lag not in still) == effect.has("lag")
    assert (subject.compiled.delays(np.array([10.0]))[0] != 0) == effect.has("delay")
    assert (subject.compiled.tendon_friction not in still) == effect.has("friction")
    assert (subject.compiled.pressure_hysteresis not in still) == effect.has("hysteresis")
    assert subject.null.pressure_lag in still
    assert subject.null.tendon_friction in still
    assert subject.null.pressure_hysteresis in still
    assert subject.null.command_delay in still
    assert subject.null.delays(np.array([10.0]))[0] == 0
    without = subject.null if any(effect.has(hook) for hook in ("lag", "friction", "hysteresis")) else subject.compiled
    np.testing.assert_array_equal(subject.compiled.theta_without_devices, without.theta)


@pytest.mark.usefixtures("subject_of")
@pytest.mark.parametrize("effect", [effect for effect in ALL if effect.has("lag")], ids=lambda effect: effect.name)
def test_the_lag_that_it_declares_is_the_one_of_its_memory(effect):
    """Under a constant command the pressure's distance from it falls exponentially, from below while filling, from above else."""
    model = compile_model(with_effect(NOMINAL, effect), backend="python")
    half, duration = model.layout.inputs // 2, 0.03
    inputs = np.append(np.full(half, 2e5), np.full(half, 3.0))
    off = np.where(np.arange(half) % 2, 1e4, -1e4)
    _, after = model.reference_stepper.values("input_motion", inputs, 0 * inputs, off, duration, model.theta)
    assert model.pressure_lag is not None
    filling, exhausting = model.pressure_lag
    assert after.ravel() == pytest.approx(off * np.exp(-duration / np.where(off < 0, filling, exhausting)), rel=1e-9)


@pytest.mark.usefixtures("subject_of")
@pytest.mark.parametrize("effect", ALL, ids=lambda effect: effect.name)
def test_a_model_file_with_it_reads_back_equal(effect, tmp_path):
    model = with_effect(NOMINAL, effect)
    write_model(model, tmp_path / "model.toml")
    assert read_model(tmp_path / "model.toml") == model != NOMINAL
