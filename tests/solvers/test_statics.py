"""Equilibria: SPEC's check values, a second implementation, laws of mechanics, and everything solved or explained."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tepm_opt.data.tables import read_table
from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.outcome import Ending
from tepm_opt.solvers.mechanics.statics import StaticsSettings, solve_statics, without_inputs
from tests.independent import Network
from tests.paths import reference
from tests.tools import observed, random_directions, random_inputs, variant

BASE = np.array([0, 0, -0.05])
ELONGATION = np.array([2e5] * 3 + [3e5] * 3 + [0.0] * 6)


def in_base(held):
    return held.tip - BASE


class TestCheckValues:
    """SPEC section 2 and the evidence of section 1, to the digits given there."""

    def test_no_input(self, kang):
        held = solve_statics(kang, np.zeros(12))
        assert in_base(held)[2] == pytest.approx(0.396814, abs=5e-7)
        assert held.smallest_eigenvalue == pytest.approx(0.38980, abs=5e-6)
        assert np.linalg.norm(held.tip[:2]) < 1e-12
        assert held.tip_tilt < 1e-7

    def test_elongation(self, kang):
        assert in_base(solve_statics(kang, ELONGATION))[2] == pytest.approx(0.446164, abs=5e-7)

    def test_tip_force(self, kang):
        held = solve_statics(kang, np.zeros(12), [2.5, 0, 0])
        np.testing.assert_allclose(in_base(held), [0.27210, 0.00850, 0.26514], atol=5e-6)
        assert np.rad2deg(held.tip_tilt) == pytest.approx(63.21, abs=5e-3)

    @pytest.mark.parametrize(
        ("parameters", "tilt", "elongation"),
        [({"r": 0.03}, 84.9, None), ({"r": 0.05}, 45.2, None), ({"alpha_2": 0.5}, 65.0, 58), ({}, 63.2, 49)],
    )
    def test_what_the_radius_and_the_bracing_were_chosen_by(self, parameters, tilt, elongation):
        model = compile_model(Model.from_robot("kang2017").with_parameters(**parameters))
        assert np.rad2deg(solve_statics(model, np.zeros(12), [2.5, 0, 0]).tip_tilt) == pytest.approx(tilt, abs=0.05)
        if elongation:
            rise = solve_statics(model, ELONGATION).tip[2] - solve_statics(model, np.zeros(12)).tip[2]
            assert 1e3 * rise == pytest.approx(elongation, abs=0.5)

    def test_single_diagonals_bend_out_of_the_plane_of_the_load(self):
        model = compile_model(variant(geometry={"bracing": "single"}), backend="python")
        assert 1e3 * abs(solve_statics(model, np.zeros(12), [2.5, 0, 0]).tip[1]) == pytest.approx(59, abs=0.5)

    def test_a_free_actuator_elongates_by_70_mm(self):
        """Eq. (1), III.B: p A = K_a dL; a module all but without bracing and weight."""
        free = variant(
            geometry={"modules": 1}, parameters={"alpha_2": 1e-6, "m_d": 1e-4}, mount={"gravity_m_per_s2": (0.0, 0.0, 0.0)}
        )  # fmt: skip
        model = compile_model(free, backend="python")
        held = solve_statics(model, [5e5] * 3 + [0] * 3)
        np.testing.assert_allclose(1e3 * held.lengths - 200, 70.0, atol=0.05)


@pytest.fixture(scope="module")
def solved(kang):
    """Rows of the reference, and their equilibria, all solved cold."""
    columns = np.stack(list(read_table(reference("static.csv")).columns.values()), axis=1)
    return columns, [solve_statics(kang, row[:12], row[12:15]) for row in columns]


class TestReference:
    """../shared/reference/static.csv, by another implementation."""

    def test_all_are_solved(self, solved):
        columns, held = solved
        assert len(columns) == 400
        assert all(e.solved for e in held)

    def test_points_and_lengths(self, solved):
        columns, held = solved
        np.testing.assert_allclose([observed(e) for e in held], columns[:, 15:33], rtol=0, atol=1e-6)

    def test_smallest_eigenvalues(self, solved):
        columns, held = solved
        np.testing.assert_allclose([e.smallest_eigenvalue for e in held], columns[:, 33], rtol=0, atol=1e-6)


GEOMETRIES = {
    "kang2017": {},
    "other segments": {"segments": 4, "modules": 2},
    "odd segments, three modules": {"segments": 3, "modules": 3},
    "four actuators": {"modules": 1, "angles": (0.0, 90.0, 180.0, 270.0)},
    "single bracing": {"crossed": False},
    "angles in any order": {"modules": 1, "segments": 2, "angles": (300.0, 0.0, 100.0, 200.0, 250.0)},
}


@pytest.mark.sample(3)
@pytest.mark.parametrize("geometry", GEOMETRIES.values(), ids=GEOMETRIES)
def test_the_independent_network_finds_the_same_equilibrium(geometry):
    """SciPy's trust-region minimiser on a potential written a second time, from the same rest."""
    settings = {"modules": 2, "segments": 6, "angles": (90.0, 210.0, 330.0), "crossed": True} | geometry
    keys = {"modules": settings["modules"], "segments_per_module": settings["segments"], "actuator_angles_deg": settings["angles"]}
    model = compile_model(variant(geometry=keys | {"bracing": "crossed" if settings["crossed"] else "single"}), backend="python")
    other = Network(**settings | {"angles": tuple(np.deg2rad(settings["angles"]))})
    inputs, forces = random_inputs(model, 4, 0, 0, 0.8), 0.4 * random_directions(4, 1)
    inputs[0], forces[0] = 0.0, (1.0, 0.0, 0.0)
    for u, force in zip(inputs, forces, strict=True):
        held = solve_statics(model, u, force)
        nodes, eigenvalue = other.solve(other.push(u), other.loads(force))
        assert held.solved
        assert abs(held.nodes - nodes).max() < 1e-8
        assert abs(held.points - other.points(nodes)).max() < 1e-8
        assert abs(held.lengths - other.lengths(nodes)).max() < 1e-8
        assert held.smallest_eigenvalue == pytest.approx(eigenvalue, abs=1e-6)


class TestMechanics:
    def test_the_energy_is_stationary(self, kang):
        """Central differences of the energy along every coordinate: a residual of at most 1 uN."""
        for u, force in zip(random_inputs(kang, 3, 1), random_directions(3, 2), strict=True):
            held = solve_statics(kang, u, force)
            gradient, h = [], 1e-6
            for at in np.ndindex(held.x[1:].shape):
                step = np.zeros_like(held.x)
                step[1:][at] = h
                up, down = (kang.reference.energy(held.x + s * step, held.properties, kang.theta) for s in (1, -1))
                gradient.append((up - down) / (2 * h))
            assert abs(np.array(gradient)).max() < 1e-6

    def test_the_base_carries_weight_and_load(self, kang):
        """Edge forces between levels 0 and 1 add up to everything above."""
        force = np.array([0.7, -0.4, 0.2])
        held = solve_statics(kang, random_inputs(kang, 1, 3)[0], force)
        verticals_and_diagonals = [k for k, edge in enumerate(kang.layout.edges) if edge.a[0] == 0]
        total = np.zeros(3)
        for k in verticals_and_diagonals:
            edge = kang.layout.edges[k]
            span = held.nodes[1, edge.b[1]] - held.nodes[0, edge.a[1]]
            total += held.edge_forces[0, k] * span / np.linalg.norm(span)
        np.testing.assert_allclose(total, force - [0, 0, 2 * 0.22 * 9.81], atol=1e-7)

    def test_lengths_are_sums_of_edges_and_points_centroids(self, kang):
        held = solve_statics(kang, random_inputs(kang, 1, 4)[0])
        spans = np.linalg.norm(np.diff(held.nodes, axis=0), axis=2)
        np.testing.assert_allclose(held.lengths, spans.reshape(2, 6, 3).sum(axis=1), atol=1e-14)
        np.testing.assert_allclose(held.points, held.nodes[[3, 6, 9, 12]].mean(axis=1) + BASE, atol=1e-14)

    def test_hanging_down_reverses_the_weight(self, kang):
        """Turned upside down, pressure lengthens the robot downwards; SPEC: hanging, z_s4 rises with p_13 over 10 … 20 %."""
        hanging = compile_model(variant(mount={"base_rotation_deg": (180.0, 0.0, 0.0)}), backend="python")
        reversed_ = compile_model(variant(mount={"gravity_m_per_s2": (0.0, 0.0, 9.81)}), backend="python")
        tips = []
        for part in (0.10, 0.20):
            u = np.zeros(12)
            u[2] = part * 5e5
            found, expected = solve_statics(hanging, u), solve_statics(reversed_, u)
            np.testing.assert_allclose(found.points - BASE, (expected.points - BASE) * [1, -1, -1], atol=1e-9)
            assert abs(found.lengths - expected.lengths).max() < 1e-9
            tips.append(found.tip[2])
        assert tips[1] > tips[0]

    def test_a_tilted_base_tilts_gravity_and_loads(self):
        """Everything known in G turns into the base frame together."""
        turn = variant(mount={"base_rotation_deg": (0.0, 90.0, 0.0)}).mount.rotation
        tilted = compile_model(variant(mount={"base_rotation_deg": (0.0, 90.0, 0.0)}), backend="python")
        straight = compile_model(variant(mount={"gravity_m_per_s2": tuple(turn.T @ [0, 0, -9.81])}), backend="python")
        u, force = random_inputs(tilted, 1, 5)[0] / 2, np.array([0.3, 0.2, -0.1])
        found, expected = solve_statics(tilted, u, force), solve_statics(straight, u, turn.T @ force)
        np.testing.assert_allclose(found.points - BASE, (expected.points - BASE) @ turn.T, atol=1e-9)


PARTS = st.lists(st.floats(0, 1), min_size=12, max_size=12)


class TestSymmetry:
    """The network is a regular triangular prism."""

    @given(PARTS)
    def test_rotating_the_inputs_rotates_the_robot(self, kang, parts):
        u = np.array(parts) * kang.input_max
        turned = np.roll(u.reshape(4, 3), 1, axis=1).ravel()  # j -> j + 1: by 120 deg
        found, other = solve_statics(kang, u), solve_statics(kang, turned)
        assert found.solved
        assert other.solved
        c, s = np.cos(2 * np.pi / 3), np.sin(2 * np.pi / 3)
        np.testing.assert_allclose(other.points, found.points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T, atol=1e-8)
        np.testing.assert_allclose(other.lengths, np.roll(found.lengths, 1, axis=1), atol=1e-8)

    @given(PARTS)
    def test_mirroring_the_inputs_mirrors_the_robot(self, kang, parts):
        u = np.array(parts) * kang.input_max
        mirrored = u.reshape(4, 3)[:, [0, 2, 1]].ravel()  # across the y-z plane, which actuator 1 lies in
        found, other = solve_statics(kang, u), solve_statics(kang, mirrored)
        np.testing.assert_allclose(other.points, found.points * [-1, 1, 1], atol=1e-8)

    @given(st.floats(0, 5e5), st.floats(0, 5e5), st.floats(0, 7), st.floats(0, 7))
    def test_equal_inputs_keep_it_straight(self, kang, p_1, p_2, tension_1, tension_2):
        held = solve_statics(kang, np.repeat([p_1, p_2, tension_1, tension_2], 3))
        assert np.linalg.norm(held.points[:, :2]) < 1e-8
        assert np.ptp(held.lengths, axis=1).max() < 1e-8

    @given(PARTS)
    def test_only_the_axial_force_counts(self, kang, parts):
        """F_a = p A - lambda, Eq. (3): a newton of tension is as good as 1 / A less pressure."""
        u = np.array(parts) * kang.input_max
        tension = np.minimum(u[:6] * 50.27e-6, u[6:])
        without = u - np.concatenate([tension / 50.27e-6, tension])
        np.testing.assert_allclose(solve_statics(kang, u).points, solve_statics(kang, np.abs(without)).points, atol=1e-8)


class TestRobustness:
    def test_every_input_in_range_is_solved_cold(self, kang):
        """2,000 inputs: 1,500 spread over the ranges, 500 corners."""
        corners = np.random.default_rng(1).integers(0, 2, (500, 12)) * kang.input_max
        for u in np.concatenate([random_inputs(kang, 1500, 0), corners]):
            held = solve_statics(kang, u)
            assert held.solved, held.outcome.message
            assert held.residual < 1e-9
            assert held.iterations <= 20
            assert held.reached == 1
            assert 0.05 < held.lengths.min() < held.lengths.max() < 0.35

    def test_found_equilibria_are_stable(self, kang):
        for u in np.random.default_rng(2).integers(0, 2, (50, 12)) * kang.input_max:
            assert solve_statics(kang, u).smallest_eigenvalue > 0.1

    @pytest.mark.parametrize("part", [0, 1])
    def test_every_tip_load_is_solved_or_explained(self, kang, part):
        """300 loads up to 3 N, without inputs and with random ones."""
        inputs = part * random_inputs(kang, 300, 3)
        sizes = np.random.default_rng(4).uniform(0, 3, 300)
        solved = 0
        for u, force in zip(inputs, sizes[:, None] * random_directions(300, 5), strict=True):
            held = solve_statics(kang, u, force)
            solved += held.solved
            assert held.solved or (held.outcome.message and 0 < held.reached < 1)
        assert solved >= 297

    def test_straight_down_it_buckles(self, kang):
        held = solve_statics(kang, np.zeros(12), [0, 0, -3.0])
        assert held.outcome.ending is Ending.UNSTABLE
        assert not held.solved
        assert 0.4 < held.reached < 0.5
        assert held.smallest_eigenvalue < 0
        assert "unstable" in held.outcome.message
        assert f"{100 * held.reached:.1f} %" in held.outcome.message
        just_below, just_above = (solve_statics(kang, np.zeros(12), [0, 0, -3.0 * held.reached * part]) for part in (0.999, 1.001))
        assert just_below.solved
        assert not just_above.solved

    def test_too_few_iterations_are_explained(self, kang):
        held = solve_statics(kang, ELONGATION, [1, 0, 0], settings=StaticsSettings(max_iterations=1))
        assert held.outcome.ending is Ending.NOT_CONVERGED
        assert "not converged" in held.outcome.message
        assert held.reached < 1

    def test_what_counts_as_collapsed_is_a_setting(self, kang):
        held = solve_statics(kang, [0.0] * 6 + [7.0] * 6, settings=StaticsSettings(min_length_ratio=0.99))
        assert held.outcome.ending is Ending.COLLAPSED
        assert "below 0.99 of its rest length" in held.outcome.message

    def test_warm_start_equals_cold_start(self, kang):
        path = random_inputs(kang, 2, 6)
        last = None
        for part in np.linspace(0, 1, 30):
            u = (1 - part) * path[0] + part * path[1]
            cold, last = solve_statics(kang, u), solve_statics(kang, u, start=last)
            np.testing.assert_allclose(last.x, cold.x, rtol=0, atol=1e-9)
            assert last.iterations <= cold.iterations

    def test_a_bad_start_does_not_matter(self, kang):
        """Started from a robot that lies on its side under a load that is gone."""
        bent = solve_statics(kang, np.zeros(12), [3.0, 0, 0])
        for u in random_inputs(kang, 20, 7):
            np.testing.assert_allclose(solve_statics(kang, u, start=bent).x, solve_statics(kang, u).x, rtol=0, atol=1e-9)

    @pytest.mark.parametrize("wrong", [np.zeros(11), [np.nan] * 12, [6e5] + [0.0] * 11, [-1.0] + [0.0] * 11])
    def test_wrong_inputs_are_refused(self, kang, wrong):
        with pytest.raises(InputError, match="inputs: "):
            solve_statics(kang, wrong)


def test_a_row_without_inputs_has_a_status_too(kang):
    nothing = without_inputs(kang, np.full(12, np.nan), np.zeros((4, 3)))
    assert nothing.outcome.ending is Ending.NO_INPUTS
    assert not nothing.solved
    assert nothing.outcome.message
    assert np.isnan(observed(nothing)).all()


def test_loads_on_any_point(kang):
    """The sum of the four points' forces at the tip is another load than each at its point."""
    loads = np.zeros((4, 3))
    loads[1] = 1.0, 0.0, 0.0
    at_s2, at_tip = solve_statics(kang, np.zeros(12), loads), solve_statics(kang, np.zeros(12), [1.0, 0, 0])
    other = Network()
    force = other.loads()
    force[5] += np.array([1.0, 0, 0]) / 3
    nodes, _ = other.solve(other.push(np.zeros(12)), force)
    assert abs(at_s2.nodes - nodes).max() < 1e-8
    assert at_tip.tip[0] > 2 * at_s2.tip[0] > 0
