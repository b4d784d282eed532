"""Keeping out of obstacles: shapes, files, the way led round them, the program's rows, and closed loops beside a sphere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tepm_opt.control.collision.constraints import CollisionConstraints
from tepm_opt.control.collision.elastic_band import detour
from tepm_opt.control.collision.geometry import BoxObstacle, ObstacleFile, Obstacles, SphereObstacle, TableObstacle, read_obstacles
from tepm_opt.control.collision.model import CollisionModel
from tepm_opt.control.estimation.kalman_filter import DiscreteModalModel
from tepm_opt.control.loop import LoopRecord, close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.mpc.prediction import PredictionModel, Weights
from tepm_opt.control.references.reference import Reference, approach, reference_of
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.jobs.clearance import clearance
from tepm_opt.jobs.closed_loop import ClosedLoop, LoopSetup
from tepm_opt.jobs.plan import tell_rest_inside
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.linear.modal_model import modal_model
from tepm_opt.solvers.mechanics.statics import solve_actuated_statics
from tepm_opt.solvers.planning.program import distance

SPHERE = SphereObstacle(name="lamp", centre_m=(0.1, -0.05, 0.3), radius_m=0.06)
BOX = BoxObstacle(name="shelf", centre_m=(0.0, 0.1, 0.2), size_m=(0.1, 0.2, 0.05), rotation_deg=(20.0, -35.0, 50.0))
TABLE = TableObstacle(point_m=(0.0, 0.0, 0.1), normal=(0.3, -0.2, 1.0))
TEXT = """
margin_m = 0.008
[[spheres]]
name = "lamp"
centre_m = [0.1, 0.0, 0.3]
radius_m = 0.05
[[boxes]]
name = "shelf"
centre_m = [0.0, 0.3, 0.2]
size_m = [0.1, 0.2, 0.05]
rotation_deg = [0, 0, 30]
margin_m = 0.02
[table]
height_m = 0.01
"""
GAP = 0.010  # m between the sphere beside the path's end and where the tip would come to stand within it


class TestShapes:
    @pytest.mark.parametrize("shape", [SPHERE, BOX, TABLE], ids=lambda shape: shape.name)
    def test_the_normal_is_the_distance_s_gradient(self, shape: SphereObstacle | BoxObstacle | TableObstacle) -> None:
        """Inside and outside, away from edges, where there is none."""
        points = np.random.default_rng(4).uniform(-0.3, 0.5, (400, 3))
        distance, normal = shape.nearest(points)
        assert (distance < 0).any()
        assert (distance > 0).any()
        step = 1e-6
        slope = [(shape.nearest(points + step * axis)[0] - shape.nearest(points - step * axis)[0]) / (2 * step) for axis in np.eye(3)]
        np.testing.assert_allclose(normal, np.array(slope).T, atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0)
        surface = points - distance[:, None] * normal
        np.testing.assert_allclose(shape.nearest(surface)[0], 0.0, atol=1e-12)

    def test_a_box_by_sampling_its_surface(self) -> None:
        """No point of the surface is nearer, and one is as near."""
        random = np.random.default_rng(5)
        own = random.uniform(-0.5, 0.5, (60000, 3))
        own[np.arange(len(own)), random.integers(0, 3, len(own))] = random.choice([-0.5, 0.5], len(own))
        turn = Rotation.from_rotvec(np.deg2rad(BOX.rotation_deg)).as_matrix()
        surface = np.array(BOX.centre_m) + (own * np.array(BOX.size_m)) @ turn.T
        for point in random.uniform(-0.2, 0.3, (20, 3)):
            near = np.linalg.norm(surface - point, axis=1).min()
            assert abs(BOX.nearest(point[None])[0][0]) == pytest.approx(near, abs=2e-3)

    def test_the_centre_of_a_sphere_has_a_way_out(self) -> None:
        distance, normal = SPHERE.nearest(np.array([SPHERE.centre_m]))
        assert distance[0] == -SPHERE.radius_m
        assert np.linalg.norm(normal) == 1.0


class TestFile:
    def test_reads_shapes_and_margins(self, tmp_path: Path) -> None:
        (tmp_path / "o.toml").write_text(TEXT, encoding="utf-8")
        found = read_obstacles(tmp_path / "o.toml")
        assert found.names == ("lamp", "shelf", "table")
        np.testing.assert_array_equal(found.margins, [0.008, 0.02, 0.008])
        np.testing.assert_allclose(found.nearest(np.array([[0.1, 0.0, 0.4]]))[0][0, [0, 2]], [0.05, 0.39])

    @pytest.mark.parametrize(
        ("old", "new", "says"),
        [
            ("radius_m = 0.05", "radius_m = -1", r"o\.toml: spheres entry 1: radius_m = -1.*valid: 0.0001 … 10 m"),
            ("centre_m = [0.1, 0.0, 0.3]", "centre_m = [100, 0, 300]", "millimetres"),
            ('name = "shelf"', 'name = "lamp"', "two obstacles are named 'lamp'"),
            ("size_m", "sizes_m", "unknown key 'sizes_m'"),
            ("height_m = 0.01", "", "height_m, or point_m with a normal"),
            ("height_m = 0.01", "height_m = 0.0\nnormal = [0, 0, 1]", "height_m and normal"),
            ("height_m = 0.01", "point_m = [0, 0, 0]\nnormal = [0, 0, 0]", "normal is 0 long"),
            ("margin_m = 0.008", "margin_m = ", r"line 2"),
            ("margin_m = 0.02", 'margin_m = "much"', "margin_m = 'much'"),
        ],
    )
    def test_faults_are_named(self, tmp_path: Path, old: str, new: str, says: str) -> None:
        assert old in TEXT
        (tmp_path / "o.toml").write_text(TEXT.replace(old, new), encoding="utf-8")
        with pytest.raises(InputError, match=says):
            read_obstacles(tmp_path / "o.toml")

    def test_nothing_in_it(self, tmp_path: Path) -> None:
        (tmp_path / "o.toml").write_text("margin_m = 0.01\n", encoding="utf-8")
        with pytest.raises(InputError, match="no obstacle"):
            read_obstacles(tmp_path / "o.toml")


@pytest.fixture(scope="module")
def beside(kang: CompiledModel, short: Reference) -> CollisionModel:
    """A sphere that the short reference's last second would run 10 mm into."""
    tip, before = short.tips[400], short.tips[390]
    way = np.cross(tip - before, [0.0, 0.0, 1.0])
    centre = tip + (0.03 - GAP) * way / np.linalg.norm(way)
    sphere = SphereObstacle(name="lamp", centre_m=tuple(map(float, centre)), radius_m=0.03)
    return CollisionModel(kang, Obstacles(ObstacleFile(margin_m=0.006, spheres=(sphere,))))


@pytest.fixture(scope="module")
def led(kang: CompiledModel, short: Reference, beside: CollisionModel) -> Reference:
    return detour(kang, short, beside)


def part(reference: Reference, periods: int) -> Reference:
    """The last periods of a reference."""
    few = {name: getattr(reference, name)[-periods:] for name in ("tips", "forces", "equilibria", "counted", "point")}
    return Reference(**few)


def distances(keep_out: CollisionModel, reference: Reference) -> np.ndarray:
    """Least distance in every period, (periods,) in m."""
    return np.array([keep_out.nearest(places).distance for places in keep_out.locate_watched_points(reference.equilibria)])


class TestDetour:
    def test_keeps_the_margin_and_moves_no_more_than_it_must(self, short: Reference, beside: CollisionModel, led: Reference) -> None:
        before, after = distances(beside, short), distances(beside, led)
        assert before.min() == pytest.approx(-GAP, abs=1e-4)
        assert after.min() > 0.006 - 2.1e-4
        assert led.moved is not None
        np.testing.assert_allclose(led.moved, np.linalg.norm(led.tips - short.tips, axis=1))
        assert 0.016 - 3e-4 < led.moved.max() < 0.019, "gap and margin, and little more"

    def test_is_in_balance_and_smooth(self, kang: CompiledModel, short: Reference, led: Reference) -> None:
        for k in (0, 350, 399, 449):
            inputs = np.concatenate([led.forces[k] / kang.values["A"], np.zeros(6)])
            found = solve_actuated_statics(kang, inputs, kang.check_loads(None), led.equilibria[k], explain=True)
            np.testing.assert_allclose(found.tip, led.tips[k], atol=1e-7)
        bend = np.abs(np.diff(led.tips, 2, axis=0)).max() / short.period**2
        assert bend < np.abs(np.diff(short.tips, 2, axis=0)).max() / short.period**2 + 0.5
        assert np.abs(np.diff(led.forces, axis=0)).max() / short.period < 30.0

    def test_what_is_far_changes_nothing(self, kang: CompiledModel, short: Reference) -> None:
        found = detour(kang, short, CollisionModel(kang, Obstacles(ObstacleFile(table=TableObstacle(height_m=-0.5)))))
        assert found.tips is short.tips
        assert found.moved is not None
        assert not found.moved.any()

    def test_an_arm_that_touches_while_its_tip_does_not(self, kang: CompiledModel, short: Reference) -> None:
        """A ball at the elbow: the arm bends away, and its tip moves far less than the elbow has to."""
        elbow, place = 1, short.equilibria[-1].points[1]
        ball = SphereObstacle(name="ball", centre_m=(float(place[0]) + 0.021, float(place[1]), float(place[2])), radius_m=0.02)
        keep_out = CollisionModel(kang, Obstacles(ObstacleFile(margin_m=0.004, spheres=(ball,))))
        found = detour(kang, part(short, 100), keep_out)
        assert found.moved is not None
        moved = np.linalg.norm(found.equilibria[-1].points[elbow] - place)
        assert distances(keep_out, found).min() > 0.004 - 2.1e-4
        assert moved > 2.5e-3
        assert found.moved.max() < moved / 2

    def test_no_way_is_told(self, kang: CompiledModel, short: Reference) -> None:
        wide = ObstacleFile(spheres=(SphereObstacle(name="pillar", centre_m=(0.0, 0.0, 0.2), radius_m=0.3),))
        with pytest.raises(InputError, match=r"at .* s of the path .* from 'pillar'"):
            detour(kang, part(short, 30), CollisionModel(kang, Obstacles(wide)))


class Pushed(SimulatedRig):
    """The virtual prototype, whose tip is pushed along x with 0.3 N for a second and a half."""

    def read(self) -> Sample:
        """As of the rig, pushed."""
        self.push(np.array([0.3 if 2.5 <= self.time < 4.0 else 0.0, 0.0, 0.0]))
        return super().read()


@pytest.mark.slow
def test_the_program_keeps_the_elbow_out(kang: CompiledModel) -> None:
    """A ball 5 mm beside the elbow: the cost hardly knows the elbow, the rows do."""
    lead = approach(kang, np.array([0.15, 0.0, 0.35]), 1.5)
    path = reference_of(kang, np.vstack([lead, np.repeat(lead[-1:], 270, axis=0)]))
    place = path.equilibria[-1].points[1]
    ball = SphereObstacle(name="ball", centre_m=(float(place[0]) + 0.025, float(place[1]), float(place[2])), radius_m=0.02)
    keep_out = CollisionModel(kang, Obstacles(ObstacleFile(margin_m=0.003, spheres=(ball,))))
    known, least = detour(kang, path, keep_out), np.zeros((2, 3))
    for noise in range(3):
        for without in (0, 1):
            rig = Pushed()
            rig.reseed(1 + noise)
            controller = Mpc(kang, replace(known, keep_out=None) if without else known)
            controller.reference = known  # either way distances are logged
            least[without, noise] = min(close_loop(rig, controller, kang.robot).distance[200:])
    assert least[0].mean() > 0
    assert least[1].mean() < -5e-4


def test_rows_are_the_distances_by_the_forces(short: Reference, led: Reference, beside: CollisionModel) -> None:
    """R v − r + margin is the distance that the arm's prediction, computed stage by stage, has under forces v near those of the plan."""
    stages, row, random = 6, 395, np.random.default_rng(3)
    operating = DiscreteModalModel.from_modal_model(modal_model(led.equilibria[row]), led.forces[row], led.period)
    rows = row + 2 * np.arange(-1, stages + 8)
    forecast = PredictionModel(Weights(), stages)
    motion = np.append(2e-3 * random.normal(size=10), np.zeros(10))
    forecast.prepare(operating, led, rows)
    forecast.horizon.set_initial_state(motion, np.zeros(3))
    bias, begin, plan = 1e-3 * random.normal(size=(4, 3)), 0.1 * random.normal(size=6), 0.1 * random.normal(size=(stages, 6))
    found = CollisionConstraints(beside, led, stages)
    R, r = found.linearise(forecast.horizon, operating.model, rows[2 : stages + 1], bias, begin, plan)
    assert R.shape == (found.count, 6 * stages)

    def least(forces: np.ndarray) -> list[float]:
        horizon, state, at = forecast.horizon, forecast.horizon.free[0], []
        before = begin
        drift = [horizon.free[k + 1] - horizon.stage.A @ horizon.free[k] for k in range(stages)]
        for k in range(stages - 1):
            state = horizon.stage.A @ state + drift[k] + horizon.by_start @ before + horizon.by_end @ forces[k]
            before = forces[k]
            places = (
                beside.locate_watched_points([led.equilibria[rows[k + 2]]])[0]
                + beside.offsets(bias)
                + beside.observe(operating.model) @ state[:10]
            )
            at += list(beside.obstacles.nearest(places)[0][:, 0])
        return sorted(at)

    margin = beside.obstacles.margins[0]
    np.testing.assert_allclose(np.sort(R @ plan.ravel() - r + margin), least(plan)[: found.count], atol=1e-9)
    other = plan + 1e-3 * random.normal(size=plan.shape)
    np.testing.assert_allclose(np.sort(R @ other.ravel() - r + margin), least(other)[: found.count], atol=1e-7)


@pytest.fixture(scope="module")
def kept(kang: CompiledModel, led: Reference) -> LoopRecord:
    rig = SimulatedRig()
    rig.reseed(1)
    return close_loop(rig, Mpc(kang, led), kang.robot)


class TestLoop:
    @pytest.mark.slow
    def test_the_true_arm_keeps_out(self, beside: CollisionModel, followed: LoopRecord, kept: LoopRecord) -> None:
        """On the virtual prototype, which differs from the model: without, the arm goes through the sphere."""
        assert kept.outcome.solved
        assert min(kept.distance) > -1e-3
        assert beside.obstacles.nearest(np.array(followed.truth))[0].min() < -6e-3

    def test_the_log_says_how_near(self, kang: CompiledModel, kept: LoopRecord) -> None:
        loop = ClosedLoop.from_record(kept, kang, LoopSetup())
        columns, told = loop.columns(), loop.summary()["keep_out"]
        assert told["true"]["smallest_m"] == min(kept.distance)
        assert told["estimated"]["smallest_m"] == columns["distance_m"].min()
        assert (told["estimated"]["obstacle"], told["estimated"]["point"]) == ("lamp", "s4")
        assert np.abs(columns["distance_m"] - columns["true_distance_m"])[100:].max() < 6e-3
        assert not loop.doubts

    def test_inside_is_told(self, kang: CompiledModel, kept: LoopRecord) -> None:
        bad = replace(kept, distance=[*kept.distance[:300], -2e-3, *kept.distance[301:]])
        loop = ClosedLoop.from_record(bad, kang, LoopSetup())
        since, says = loop.doubts["keep out, in truth"]
        assert since == pytest.approx(kept.time[300])
        assert "2 mm inside lamp" in says

    def test_without_obstacles_nothing_is_told(self, kang: CompiledModel, followed: LoopRecord) -> None:
        loop = ClosedLoop.from_record(followed, kang, LoopSetup())
        assert loop.summary()["keep_out"] is None
        assert "distance_m" not in loop.columns()
        assert clearance({}, np.zeros(0), np.nan) is None


def test_an_arm_that_is_inside_at_rest_is_told(kang: CompiledModel) -> None:
    """The tip stands at z = 0.346814 m in G (SPEC section 2): 3.2 mm from the sphere's centre."""
    hand = SphereObstacle(name="hand", centre_m=(0.0, 0.0, 0.35), radius_m=0.04)
    told = CollisionModel(kang, Obstacles(ObstacleFile(spheres=(hand,)))).at_rest()
    assert told.startswith("the arm at rest is inside 'hand' by 37 mm")
    assert CollisionModel(kang, Obstacles(ObstacleFile(spheres=(SPHERE,)))).at_rest() == ""
    assert tell_rest_inside(kang, {"hand": hand.for_planning(0.0)}) == told


@pytest.mark.parametrize("shape", [SPHERE, BOX, TABLE], ids=lambda shape: shape.name)
def test_planning_keeps_the_same_distances(shape: SphereObstacle | BoxObstacle | TableObstacle) -> None:
    points = np.random.default_rng(5).uniform(-0.3, 0.5, (40, 3))
    exact = shape.nearest(points)[0] - 0.01
    outside = distance(shape.for_planning(0.01))
    found = np.array([float(outside(point)) for point in points])
    assert (found <= exact + 1e-6).all(), "never farther than it is"
    assert ((found < 0) == (exact < 0)).mean() > 0.9
