"""Each imperfection against a hand calculation on the bar: ΔL = (p A − λ) / K_a but for the imperfection."""

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command
from tepm_opt.hw.simulation.imperfections import Imperfections
from tepm_opt.hw.simulation.imperfections.around import TipDrag
from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.hw.simulation.imperfections.body import BaseTilt, MassDistribution, Payload, RigidPlates, SoftPart, TwistedBody, UnevenMass
from tepm_opt.hw.simulation.imperfections.unlike import ActuatorScatter
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import load_robot
from tests.hw.rigs import AREA, DAMPING, LENGTH, RADIUS, STIFFNESS, bar, inputs, ramps, read_until, resting, rig_of, robot_file

G = 9.81


def body_with(imperfection) -> Body:
    """The network of kang2017 changed by one imperfection."""
    body = Body.from_robot(load_robot("kang2017"), seed=3)
    imperfection.change_body(body)
    return body


def centre(body: Body) -> np.ndarray:
    """Centre of mass of the nodes at rest, (3,) in m."""
    nodes = body.layout.rest_positions(RADIUS, LENGTH)[1:]
    return np.einsum("ji,jik->k", body.mass, nodes) / body.mass.sum()


def test_every_name_of_the_specification_is_there_and_off():
    """SPEC section 5, and some more: other forms, and foreign ones."""
    names = {
        "payload", "mass_distribution", "rigid_plates", "stiffness_hardening", "structural_friction", "creep", "pressure_dead_zone",
        "pressure_hysteresis", "regulator_lag", "time_delay", "actuator_gain", "pressure_crosstalk", "tendon_friction", "tendon_slack",
        "external_load", "base_tilt", "sensor_misalignment", "sensor_offset", "actuator_offset", "regulator_leak", "actuator_scatter",
    }  # fmt: skip
    foreign = {"uneven_mass", "soft_part", "twisted_body", "tip_wall", "tethered_tip", "tip_drag", "field_distortion"}
    timed = {"warm_up", "tracker_drift", "tendon_slip", "base_vibration", "clock_skew", "sample_jitter"}
    assert set(Imperfections.model_fields) == names | foreign | timed | {"choked_filling", "tension_gain"}
    assert Imperfections().active == {}


def test_payload():
    """A hanging bar is longer by m g / 3 K_a; beside the centre the plate's centre of mass is where it was put."""
    longer = resting(bar(G, payload={"mass_kg": 0.05})) - resting(bar(G))
    assert longer == pytest.approx(np.full(3, 0.05 * G / (3 * STIFFNESS)), rel=5e-3)
    body, plain = body_with(Payload(mass_kg=0.1, eccentricity_m=(0.01, -0.005))), Body.from_robot(load_robot("kang2017"))
    added = body.mass - plain.mass
    assert added.sum() == pytest.approx(0.1)
    assert added[-1] @ body.layout.rest_positions(RADIUS, LENGTH)[-1][:, :2] == pytest.approx(0.1 * np.array([0.01, -0.005]))
    with pytest.raises(InputError, match="outside the tip plate"):
        body_with(Payload(mass_kg=0.1, eccentricity_m=(0.2, 0)))


def test_mass_distribution():
    """40 % of 0.22 kg moves to the plate: level 2 carries 0.154 kg instead of 0.11, so the hanging upper segment stretches more."""
    longer = resting(bar(G, mass_distribution={"fraction": 0.4})) - resting(bar(G))
    assert longer == pytest.approx(np.full(3, (0.154 - 0.11) * G / (3 * 2 * STIFFNESS)), rel=5e-3)
    body = body_with(MassDistribution(fraction=0.32, holder_share=0.25))
    assert body.mass.sum() == pytest.approx(0.44)
    levels = body.mass.sum(axis=1)
    spread = 0.68 * 0.22 / 6
    assert levels[[0, 2, 5, 8, 11]] == pytest.approx(
        [spread, spread + 0.08 * 0.22, spread + 0.24 * 0.22, spread + 0.08 * 0.22, spread + 0.24 * 0.22]
    )


def test_uneven_mass():
    """The centre of mass moves by r / 2 times the fraction; the total stays; the standing arm leans to the heavy side."""
    body = body_with(UnevenMass(fraction=0.2, toward_deg=40))
    assert body.mass.sum() == pytest.approx(0.44)
    side = RADIUS / 2 * 0.2
    assert centre(body)[:2] == pytest.approx([side * np.cos(np.deg2rad(40)), side * np.sin(np.deg2rad(40))])
    scattered = body_with(UnevenMass(scatter=0.1)).mass
    assert scattered.sum() == pytest.approx(0.44)
    assert scattered.std() / scattered.mean() == pytest.approx(0.1, rel=0.3)
    assert rig_of(imperfections={"uneven_mass": {"fraction": 0.2, "toward_deg": 0}}).true_points[-1, 0] > 1e-3


def test_rigid_plates():
    """Each of the bar's segments of 100 mm loses 20 mm to a plate: 80 % of the elongation is left."""
    clamped = bar(rigid_plates={"clamped_length_m": 0.02})
    assert resting(clamped, 0.3e6) - LENGTH == pytest.approx(np.full(3, 0.8 * 0.3e6 * AREA / STIFFNESS), rel=2e-3)
    factor = body_with(RigidPlates(clamped_length_m=0.01)).stiffness / Body.from_robot(load_robot("kang2017")).stiffness
    assert factor[:, 0] == pytest.approx(np.where(np.isin(np.arange(12), [0, 5, 6, 11]), 1 / 0.7, 1.0))
    assert factor[:, 3:6] == pytest.approx(1)  # horizontals
    with pytest.raises(InputError, match="leaves nothing of a segment"):
        body_with(RigidPlates(clamped_length_m=0.04))


def test_soft_part():
    """One of the bar's two segments gives way by 1 / 0.8 of what it did."""
    soft = resting(bar(soft_part={"loss": 0.2, "first": 2, "last": 2}), 0.2e6) - LENGTH
    assert soft == pytest.approx(np.full(3, (0.5 + 0.5 / 0.8) * 0.2e6 * AREA / STIFFNESS), rel=2e-3)
    with pytest.raises(InputError, match="segments 2 … 13; valid: 1 … 12"):
        body_with(SoftPart(loss=0.1, first=2, last=13))


def test_twisted_body():
    """A segment turns until its diagonals are as they are made: a diagonal's square changes by 2 r^2 (cos 120° - cos(120° + twist))."""
    body = body_with(TwistedBody(strain=0.01))
    assert body.rest[:, body.verticals] == pytest.approx(LENGTH / 6)
    rig = rig_of(imperfections={"twisted_body": {"strain": 0.01}}, robot=robot_file(gravity_m_per_s2=(0, 0, 0)))
    resting(rig)
    nodes = rig.true_nodes - rig.true_nodes.mean(axis=1, keepdims=True)
    angle = np.unwrap(np.arctan2(nodes[:, 0, 1], nodes[:, 0, 0]))
    square = 3 * RADIUS**2 + (LENGTH / 6) ** 2
    expected = 2 * 0.01 * square / (np.sqrt(3) * RADIUS**2)
    assert np.diff(angle) == pytest.approx(np.full(12, expected), rel=0.05)
    straight = rig_of(imperfections={"twisted_body": {"strain": -0.01}}, robot=robot_file(gravity_m_per_s2=(0, 0, 0)))
    resting(straight)
    assert np.arctan2(*straight.true_nodes[1, 0, 1::-1]) - np.pi / 2 == pytest.approx(-(angle[1] - np.pi / 2), rel=1e-3)


def hanging(**imperfections) -> float:
    """How far the tip of a hanging robot is from the axis under 0.2 N along +x, in m."""
    rig = rig_of(robot_file(gravity_m_per_s2=(0, 0, 9.81)), imperfections=imperfections)
    rig.push(np.array([0.2, 0.0, 0.0]))
    resting(rig)
    return rig.true_points[-1, 0]


def test_tip_wall():
    """Where it rests the wall pushes with its stiffness times the depth: as far as a load that is less by that."""
    free = hanging()
    place, stiffness = 0.5 * free, 500.0
    stopped = hanging(tip_wall={"stiffness_N_per_m": stiffness, "place_m": (place, 0, 0), "normal": (-2, 0, 0)})
    depth = stopped - place
    assert 0 < depth < 0.1 * free
    assert hanging(external_load={"force_N": (-stiffness * depth, 0, 0)}) == pytest.approx(stopped, abs=1e-6)
    assert hanging(tip_wall={"stiffness_N_per_m": stiffness, "place_m": (1.1 * free, 0, 0)}) == pytest.approx(free, abs=1e-9)
    with pytest.raises(InputError, match="tip_wall: normal"):
        hanging(tip_wall={"stiffness_N_per_m": 1.0, "normal": (0, 0, 0)})


def test_tethered_tip():
    """Where it rests the hose pulls as a load does that is its stiffness times the way to where it is tied."""
    rig = rig_of(imperfections={"tethered_tip": {"stiffness_N_per_m": 0.5, "place_m": (0.05, 0.02, 0.4)}})
    resting(rig, 0.1e6)
    force = 0.5 * (np.array([0.05, 0.02, 0.4]) - rig.true_points[-1])
    loaded = rig_of(imperfections={"external_load": {"force_N": tuple(force)}})
    resting(loaded, 0.1e6)
    assert rig.true_points == pytest.approx(loaded.true_points, abs=1e-7)
    assert np.linalg.norm(force[:2]) > 5e-3


def test_tip_drag():
    """It takes power off with the cube of the speed, and nothing from what stands still."""
    law = TipDrag(size_N_s2_per_m2=0.4).tip_stage(load_robot("kang2017"))
    velocity = np.array([[0.3, 0.0, -0.4], [0.0, 0.0, 0.0]])
    force = law.force(np.zeros((2, 3)), velocity)
    assert np.sum(force * velocity, axis=1) == pytest.approx([-0.4 * 0.5**3, 0.0])
    left = []
    for size in (0.0, 5.0):
        rig = rig_of(imperfections={"tip_drag": {"size_N_s2_per_m2": size}} if size else {})
        rig.push(np.array([0.1, 0.0, 0.0]))
        rig.read()
        rig.push(np.zeros(3))
        samples = read_until(rig, 5.0)
        left.append(np.ptp([sample.points[-1, 0] for sample in samples[len(samples) // 2 :]]))
    assert left[1] < 0.7 * left[0]


def test_base_tilt():
    """Leaning towards −y by 2° (about +x) pulls the arm there with g sin 2°."""
    body = body_with(BaseTilt(rotation_deg=(2.0, 0.0)))
    assert body.gravity == pytest.approx([0, -G * np.sin(np.deg2rad(2)), -G * np.cos(np.deg2rad(2))])
    tip = rig_of(imperfections={"base_tilt": {"rotation_deg": [2.0, 0.0]}}).true_points[-1]
    assert tip[1] < -0.01
    assert abs(tip[0]) < 1e-3


def test_external_load():
    """SPEC's check value: 2.5 N along x at the tip."""
    tip = rig_of(imperfections={"external_load": {"force_N": [2.5, 0, 0]}}).true_points[-1]
    assert tip == pytest.approx([0.27210, 0.00850, 0.21514], abs=1e-5)


def test_stiffness_hardening():
    """p A = K_a L_0 (exp(b ε) − 1) / b, so ε = ln(1 + b p A / (K_a L_0)) / b; nothing in compression."""
    rig = bar(stiffness_hardening={"growth": 3.0})
    strain = np.log(1 + 3 * 0.3e6 * AREA / (STIFFNESS * LENGTH)) / 3
    assert resting(rig, 0.3e6) - LENGTH == pytest.approx(np.full(3, strain * LENGTH), rel=2e-3)
    assert resting(rig, 0, 2.0) == pytest.approx(resting(bar(), 0, 2.0), abs=1e-9)


def test_stiffness_hardening_moves_to_where_it_rests():
    """The dynamic law and the static one are the same."""
    rig = bar(stiffness_hardening={"growth": 3.0})
    ramps(rig, [0, 0.2, 0.4], [0, 0.3e6, 0.3e6])
    read_until(rig, 1.5)
    assert rig.true_lengths == pytest.approx(resting(bar(stiffness_hardening={"growth": 3.0}), 0.3e6), abs=1e-6)


def test_creep():
    """A step at once elongates by p A / (K_a (1 + g)), in the long run by p A / K_a."""
    free = 0.2e6 * AREA / STIFFNESS
    for constants, part in (([1000.0], 1 / 1.25), ([0.02, 0.05], 1.0)):
        rig = bar(creep={"fraction": 0.25, "time_constants_s": constants})
        ramps(rig, [0, 0.1, 0.2], [0, 0.2e6, 0.2e6])
        read_until(rig, 1.0)
        assert rig.true_lengths - LENGTH == pytest.approx(np.full(3, free * part), rel=5e-3)


def test_structural_friction():
    """Muscles lag by the friction of an edge in both directions: ΔL = (p A ∓ (F + c_a v)) / K_a; presliding is elastic."""
    rig = bar(structural_friction={"sliding_N": 0.4, "bristle_stiffness_N_per_m": 20000.0})
    up, down = there_and_back(rig)
    rate = 0.1e6 * AREA / STIFFNESS
    lag = (0.4 + DAMPING * rate) / STIFFNESS
    assert up - LENGTH == pytest.approx(0.15e6 * AREA / STIFFNESS - lag, abs=2e-5)
    assert down - LENGTH == pytest.approx(0.15e6 * AREA / STIFFNESS + lag, abs=2e-5)
    small = bar(structural_friction={"sliding_N": 0.4, "bristle_stiffness_N_per_m": 20000.0})
    ramps(small, [0, 0.2, 0.4], [0, 2000.0, 2000.0])  # 0.1 N, a quarter of what slides
    read_until(small, 1.0)
    bend = -0.4 / 20000.0 * np.log(1 - 2000.0 * AREA / 0.4)  # of an edge; F = 0.4 N (1 - exp(-x / 20 um))
    assert small.true_lengths - LENGTH == pytest.approx(np.full(3, 2 * bend), rel=0.1)  # less what the springs hold


def test_steps_follow_stiff_bristles() -> None:
    """As stiff as 1e5 N/m beside n_e c_a they bear 52 us; a muscle with hardly a damper bears nothing that would end."""
    stiff = bar(structural_friction={"sliding_N": 0.4, "bristle_stiffness_N_per_m": 1e5})
    assert 5.0e-5 < stiff.machine.step <= stiff.machine.limit == pytest.approx(2 * DAMPING / 1e5)
    with pytest.raises(InputError, match=r"structural_friction is too stiff .* valid: 1e-06 s and longer"):
        rig_of(robot_file(c_a=1e-4), imperfections={"structural_friction": {"sliding_N": 0.4}})


def there_and_back(rig, tension=0.0) -> tuple[float, float]:
    """Length of a muscle at 0.15 MPa when 0.3 MPa are approached and left at 0.1 MPa/s."""
    ramps(rig, [0, 3, 6], [0, 0.3e6, 0], tension)
    read_until(rig, 1.5)
    up = rig.true_lengths[0]
    read_until(rig, 4.5)
    return float(up), float(rig.true_lengths[0])


def test_pressure_dead_zone():
    """Far above the threshold p_0 is missing, far below there is almost nothing."""
    rig = bar(pressure_dead_zone={"threshold_Pa": 2e4, "softness_Pa": 1e3})
    assert resting(rig, 0.2e6) - LENGTH == pytest.approx(np.full(3, 0.18e6 * AREA / STIFFNESS), rel=2e-3)
    assert np.abs(resting(rig, 1e4) - LENGTH).max() < 1e-4 * AREA * 1e4


def test_pressure_hysteresis():
    """On the way back the pressure counts by the loop's width more; at any speed."""
    plain, width = there_and_back(bar()), 8e3
    loops = there_and_back(bar(pressure_hysteresis={"width_Pa": width}))
    assert (loops[1] - loops[0]) - (plain[1] - plain[0]) == pytest.approx(width * AREA / STIFFNESS, rel=1e-2)
    assert loops[0] < plain[0]


def test_regulator_lag():
    """63 % after one time constant when filling and 63 % less after another when exhausting; the muscle follows the monitor."""
    sections = {"pressure_monitor": {"fitted": True}}
    rig = bar(sections=sections, regulator_lag={"fill_s": 0.1, "exhaust_s": 0.3})
    rig.read()
    rig.apply(Command.from_inputs(inputs(rig, 0.2e6)))
    filled = read_until(rig, 0.1)[-1]
    assert filled.pressures == pytest.approx(np.full(3, 0.2e6 * (1 - np.exp(-1))), rel=1e-6)
    read_until(rig, 3.0)
    assert rig.true_lengths - LENGTH == pytest.approx(np.full(3, 0.2e6 * AREA / STIFFNESS), rel=2e-3)
    rig.apply(Command.from_inputs(inputs(rig, 0.1e6)))
    assert read_until(rig, 3.3)[-1].pressures == pytest.approx(np.full(3, 0.1e6 * (1 + np.exp(-1))), rel=1e-6)


def test_regulator_lag_behind_a_ramp():
    """A ramp is followed late by the time constant."""
    rig = bar(sections={"pressure_monitor": {"fitted": True}}, regulator_lag={"fill_s": 0.1, "exhaust_s": 0.3})
    ramps(rig, [0, 2], [0, 0.2e6])
    assert read_until(rig, 1.5)[-1].pressures == pytest.approx(np.full(3, 0.14e6), rel=1e-6)


def test_actuator_gain():
    """Only the named muscle is shorter, by its loss."""
    lengths = resting(bar(actuator_gain={"loss": {"13": 0.06}}), 0.2e6) - LENGTH
    assert lengths == pytest.approx(0.2e6 * AREA / STIFFNESS * np.array([1, 1, 0.94]), rel=2e-3)
    tip = rig_of(imperfections={"actuator_gain": {"loss": {"13": 0.06}}})
    resting(tip, 0.1e6)
    angle = np.degrees(np.arctan2(tip.true_points[-1, 1], tip.true_points[-1, 0]))
    assert angle == pytest.approx(-30, abs=5)  # it bends towards the weak muscle, at 330°
    with pytest.raises(InputError, match=r"actuator '31'.*valid: 11, 12, 13"):
        rig_of(imperfections={"actuator_gain": {"loss": {"31": 0.06}}})


def test_an_asymmetric_hysteresis_is_as_wide_but_lies_lower():
    plain, even = there_and_back(bar()), there_and_back(bar(pressure_hysteresis={"width_Pa": 8e3}))
    found = there_and_back(bar(pressure_hysteresis={"width_Pa": 8e3, "asymmetry": 0.5}))
    lower = 0.5 * 4e3 * AREA / STIFFNESS
    assert [even[k] - found[k] for k in (0, 1)] == pytest.approx([lower, lower], rel=1e-2)
    assert found[0] < plain[0] < found[1]


def test_actuator_offset():
    """Only the named muscles are longer: by their rest length, and by what the pressure that their regulator adds makes of it."""
    lengths = resting(bar(actuator_offset={"length_m": {"12": 2e-3}, "zero_Pa": {"13": -5e3}}), 0.1e6) - LENGTH
    assert lengths == pytest.approx(0.1e6 * AREA / STIFFNESS + np.array([0, 2e-3, -5e3 * AREA / STIFFNESS]), abs=2e-5)
    tip = rig_of(imperfections={"actuator_offset": {"length_m": {"13": 3e-3}}})
    resting(tip, 0.0)
    angle = np.degrees(np.arctan2(tip.true_points[-1, 1], tip.true_points[-1, 0]))
    assert angle == pytest.approx(150, abs=5)  # it bends away from the long muscle, at 330°, without any pressure
    with pytest.raises(InputError, match=r"actuator '31'.*valid: 11, 12, 13"):
        rig_of(imperfections={"actuator_offset": {"zero_Pa": {"31": 5e3}}})


def test_actuator_scatter():
    """Areas and lengths are what the draw says, and spread as they should; another draw is another machine."""
    layout = Layout.from_robot(load_robot("kang2017"))
    many = [ActuatorScatter(area_spread=0.02, length_spread_m=1e-3, draw=k).draw_scatter(layout) for k in range(300)]
    areas, lengths = (np.array(part) for part in zip(*many, strict=True))
    assert (areas.mean(), areas.std()) == (pytest.approx(1, abs=2e-3), pytest.approx(0.02, rel=0.05))
    assert (lengths.mean(), lengths.std()) == (pytest.approx(0, abs=1e-4), pytest.approx(1e-3, rel=0.05))
    rig = bar(actuator_scatter={"area_spread": 0.02, "length_spread_m": 1e-3, "draw": 4})
    area, length = ActuatorScatter(area_spread=0.02, length_spread_m=1e-3, draw=4).draw_scatter(rig.layout)
    assert resting(rig, 0.2e6) - LENGTH == pytest.approx(0.2e6 * AREA / STIFFNESS * area + length, abs=5e-5)


def test_tension_gain():
    """A motor that believes a dynamometer that shows a tenth too much pulls a tenth less; a zero acts without a command, too."""
    pulled = resting(bar(tension_gain={"loss": {"12": 0.1}, "zero_N": {"13": 0.3}}), 0.2e6, 2.0)
    free = LENGTH + 0.2e6 * AREA / STIFFNESS
    assert free - pulled == pytest.approx(np.array([2.0, 1.8, 2.3]) / STIFFNESS, abs=3e-5)


def test_choked_filling():
    """A choked supply fills at a rate that does not depend on how far it has to go; what is left goes exponentially."""
    sections = {"pressure_monitor": {"fitted": True}}
    rig = bar(sections=sections, choked_filling={"rate_per_s": 1.0, "supply_Pa": 1.4e6, "band_Pa": 2e4, "critical_ratio": 0.3})
    rig.read()
    rig.apply(Command.from_inputs(inputs(rig, 0.3e6)))
    frames = read_until(rig, 0.1)  # choked up to 0.3 · 1.5 MPa absolute
    rate = 1.0 * (1.4e6 + 101325.0)
    assert frames[-1].pressures == pytest.approx(np.full(3, 0.1 * rate), rel=1e-2)
    assert read_until(rig, 2.0)[-1].pressures == pytest.approx(np.full(3, 0.3e6), rel=1e-4)
    rig.apply(Command.from_inputs(inputs(rig, 0.0)))
    frames = read_until(rig, 2.05)  # choked while more than 3.3 times the atmosphere is inside
    assert frames[-1].pressures == pytest.approx(np.full(3, (0.3e6 + 101325.0) * np.exp(-0.05) - 101325.0), rel=1e-2)


def test_regulator_leak():
    """A choked leak takes its share of the absolute pressure, none without pressure; the other muscles do not feel it."""
    settled = {}
    for pressure in (0.0, 0.05e6, 0.4e6):
        rig = bar(sections={"pressure_monitor": {"fitted": True}}, regulator_leak={"share": {"12": 0.05}, "critical_ratio": 0.3})
        resting(rig, pressure)
        read_until(rig, 0.2)  # it stays where it settled
        settled[pressure] = rig.read().pressures
    assert settled[0.0] == pytest.approx(np.zeros(3), abs=1.0)
    assert settled[0.4e6] == pytest.approx([0.4e6, (0.4e6 - 0.05 * 101325.0) / 1.05, 0.4e6], rel=1e-6)
    inside = settled[0.05e6][1] + 101325.0
    lost = 0.05 * inside * np.sqrt(1 - ((101325.0 / inside - 0.3) / 0.7) ** 2)
    assert 0.05e6 + 101325.0 - inside == pytest.approx(lost, rel=1e-6)


def test_pressure_crosstalk():
    """One muscle at half its range squeezes the two beside it by share · p_max · 0.5 ** 1.2; other modules feel nothing."""
    lengths = resting(bar(pressure_crosstalk={"share": 0.05}), [0.25e6, 0, 0]) - LENGTH
    free = AREA / STIFFNESS
    assert lengths == pytest.approx(free * np.array([0.25e6, 0.05 * 0.5e6 * 0.5**1.2, 0.05 * 0.5e6 * 0.5**1.2]), rel=1e-2)


def test_tendon_slack():
    """4 mm of slack behind 250 N/m: 1 N is missing less what the elongation takes up, nothing once it took up all."""
    rig = bar(tendon_slack={"length_m": 0.004, "winding_stiffness_N_per_m": 250.0})
    short = (0.05e6 * AREA - 2 + 250 * 0.004) / (STIFFNESS + 250)
    assert short < 0.004
    assert resting(rig, 0.05e6, 2.0) - LENGTH == pytest.approx(np.full(3, short), abs=1e-5)
    assert resting(rig, 0.2e6, 2.0) - LENGTH == pytest.approx(np.full(3, (0.2e6 * AREA - 2) / STIFFNESS), rel=2e-3)
    assert resting(rig, 0.0, 0.5) == pytest.approx(resting(bar(), 0.0, 0.0), abs=1e-9)  # all of it is taken up


def test_tendon_friction():
    """Drawn out the tendon's end has λ (1 + μ) + f, wound in λ (1 − μ) − f; a slack tendon cannot push."""
    friction = {"constant_N": 0.1, "share": 0.1, "bristle_stiffness_N_per_m": 5000.0}
    up, down = there_and_back(bar(tendon_friction=friction), tension=2.0)
    rate = 0.1e6 * AREA / STIFFNESS
    assert up - LENGTH == pytest.approx((0.15e6 * AREA - 2.3 - DAMPING * rate) / STIFFNESS, abs=2e-5)
    assert down - LENGTH == pytest.approx((0.15e6 * AREA - 1.7 + DAMPING * rate) / STIFFNESS, abs=2e-5)
    up, down = there_and_back(bar(tendon_friction=friction))
    assert up - LENGTH == pytest.approx((0.15e6 * AREA - 0.1 - DAMPING * rate) / STIFFNESS, abs=2e-5)
    assert down - LENGTH == pytest.approx((0.15e6 * AREA + DAMPING * rate) / STIFFNESS, abs=2e-5)


def test_time_delay():
    """Nothing moves before the delay is over."""
    rig = bar(sections={"tracker": {"rate_hz": 1000}, "pressure_monitor": {"fitted": True}}, time_delay={"delay_s": 0.02})
    rig.read()
    rig.apply(Command.from_inputs(inputs(rig, 0.1e6)))
    samples = read_until(rig, 0.03)
    assert all((sample.pressures == 0).all() for sample in samples if sample.time <= 0.02)
    assert all((sample.pressures == 0.1e6).all() for sample in samples if sample.time > 0.0205)


def test_wrong_parameters():
    """A rig that is stiffer than its file says; the controller's robot stays nominal."""
    rig = rig_of(parameter_factors={"K_a": 1.03})
    assert rig.robot.parameters.K_a == STIFFNESS
    stiff, plain = resting(rig, 0.2e6), resting(rig_of(), 0.2e6)
    assert (stiff - LENGTH) == pytest.approx((plain - LENGTH) / 1.03, rel=0.02)
