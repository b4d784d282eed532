"""The compiled engine: mechanics.c and devices.c, called through ctypes. Every array that C sees belongs to NumPy."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from importlib import resources

import numpy as np

from tepm_opt.hw.simulation.imperfections.base import Body, Numbers
from tepm_opt.hw.simulation.imperfections.session import FADE
from tepm_opt.hw.simulation.network import Network
from tepm_opt.hw.simulation.timeline import Timeline
from tepm_opt.models.backends import compiler
from tepm_opt.models.layout import Layout

LANES = 4  # levels in a vector
WORK = 7  # arrays of all coordinates, see work_of in mechanics.c
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off")
PRESSURE = ("unequal_lag", "orifices", "leak", "soft_zone", "play_stack", "squeeze", "gain", "shift")
TENSION = ("take_up", "sheath", "load_cell", "slip")
EDGE = ("bristles", "prony", "exponential", "warming")
TIP = ("wall", "tether", "drag")
KINDS = (*PRESSURE, *TENSION, *EDGE, *TIP)
"""Functions of devices.c that stand for stages: of pressures, of tensions, along the edges, around the tip."""

Pointer, Integer, Real = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double


class _Mechanics(ctypes.Structure):
    _fields_ = [
        *((name, Integer) for name in ("levels", "width")),
        *((name, Pointer) for name in ("stiffness", "damping", "preload", "inverse_mass", "fall", "rest", "x", "v")),
        *((name, Pointer) for name in ("push", "slope", "load", "still", "work")),
        *((name, Real) for name in ("step", "bound")),
    ]


class _Timeline(ctypes.Structure):
    _fields_ = [*((name, Pointer) for name in ("at", "values", "slopes", "moves")), ("knots", Integer), ("size", Integer)]


class _Stage(ctypes.Structure):
    _fields_ = [("kind", Integer), ("count", Integer), ("numbers", Pointer)]


class _Rig(ctypes.Structure):
    _fields_ = [
        ("network", _Mechanics),
        *((name, Integer) for name in ("tick", "ticks", "follows_shape", "actuators", "modules", "points")),
        *((name, Pointer) for name in ("stages", "regulators", "muscles", "tendons", "along", "around")),
        *((name, Real) for name in ("area", "pressure_grid", "tension_grid", "winding")),
        *((name, Pointer) for name in ("weights", "turn", "base", "external", "pressure", "tension", "loaded", "work")),
        *((name, Pointer) for name in ("free_fall", "shaking")),
        ("began", Real),
        *((name, Integer) for name in ("sines", "now")),
    ]


def library(layout: Layout) -> ctypes.CDLL | None:
    """The engine for robots with a layout's edges and any number of segments; None (and one warning) where there is no compiler."""
    return _library(layout.actuators, tuple((*edge.a, *edge.b) for edge in layout.edges), LANES)


@cache
def _library(nodes: int, ends: tuple[tuple[int, ...], ...], lanes: int) -> ctypes.CDLL | None:
    folder = resources.files("tepm_opt.hw.simulation")
    sizes = [f"#define {name} {value}" for name, value in (("LANES", lanes), ("NODES", nodes), ("EDGES", len(ends)), ("FADE", FADE))]
    listed = ", ".join(f"{{{', '.join(map(str, each))}}}" for each in ends)
    parts = [(folder / name).read_text(encoding="utf-8") for name in ("mechanics.c", "devices.c")]
    kinds = f"enum {{ {', '.join(kind.upper() for kind in KINDS)} }};"
    instead = "rigs run on MuJoCo, some 70 times slower"
    text = "\n".join([*sizes, f"static const int ENDS[EDGES][4] = {{{listed}}};", kinds, *parts])
    built = compiler.build([compiler.Part("rig", text, FLAGS)], "rig", ("record", "carry", "force_at_rest"), instead)
    if built is not None:
        built.record.argtypes, built.record.restype = [Pointer, Pointer, Pointer, Integer, *[Pointer] * 5], Integer
        built.carry.argtypes, built.carry.restype = [Pointer] * 2, None
        built.force_at_rest.argtypes, built.force_at_rest.restype = [Pointer, Integer, *[Pointer] * 3], None
    return built


class CompiledNetwork(Network):
    """A network that moves in C, with its devices; see `Network`.

    Attributes:
        rig: what C knows.
    """

    def __init__(self, body: Body, step: float, built: ctypes.CDLL) -> None:
        super().__init__(body, step)
        layout, self._library = self.layout, built
        n, nodes, points = layout.levels, layout.actuators, layout.points
        self._width = width = -(-n // LANES) * LANES
        row = width + LANES
        self._kept: dict[str, np.ndarray] = {}
        self._groups: dict[str, ctypes.Array[_Stage]] = {}
        self.rig = rig = _Rig(actuators=self.count, modules=layout.modules, points=points)
        net = rig.network
        net.levels, net.width, net.step, net.bound = n, width, step, self.bound
        rest = np.zeros((nodes, 3, row))
        rest[:, :, LANES + n :] = self.rest[0][:, :, None]
        rest[:, 0, LANES + n :] += 1e3 + np.arange(row - LANES - n)  # what fills up is far away
        rest[:, :, LANES - 1 : LANES + n] = self.rest.transpose(1, 2, 0)
        mechanics = {
            "stiffness": self._fill_up(body.stiffness),
            "damping": self._fill_up(body.damping),
            "preload": self._fill_up(body.stiffness * body.rest),
            "inverse_mass": self._fill_up(1 / body.mass),
            "fall": np.array(body.gravity, dtype=float),
            "rest": rest,
            "x": rest.copy(),
            "v": np.zeros_like(rest),
            "push": np.zeros((nodes, width)),
            "slope": np.zeros((nodes, width)),
            "load": np.zeros((n, 3)),
            "still": np.zeros((nodes, 3, width)),
            "work": np.zeros(WORK * rest.size + LANES),
        }
        for name, array in mechanics.items():
            setattr(net, name, self._keep(name, array))
        devices = {
            "weights": np.array(layout.point_weights),
            "turn": np.array(self.turn, dtype=float),
            "base": self.base,
            "external": np.array(body.load, dtype=float),
            "free_fall": np.array(body.gravity, dtype=float),
            "pressure": np.zeros(self.count),
            "tension": np.zeros(self.count),
            "loaded": np.full((points, 3), np.nan),
        }
        for name, array in devices.items():
            setattr(rig, name, self._keep(name, array))
        rig.work = self._keep("devices' work", np.zeros(6 * self.count + 6 * points + 4 * self.count + 4 * nodes * width))
        self._shapes = [self.rest.shape, (points, 3), (self.count,), (self.count,)]  # of a frame's nodes, points, pressures, tensions
        self._ends = np.cumsum([np.prod(shape) for shape in self._shapes]).tolist()
        self._at = ctypes.addressof(rig)
        self._timelines = (_Timeline(), _Timeline())
        self._timelines_at = [ctypes.addressof(each) for each in self._timelines]

    def _keep(self, name: str, array: np.ndarray) -> int:
        """The address of an array, which stays as long as the network."""
        self._kept[name] = np.ascontiguousarray(array)
        return self._kept[name].ctypes.data

    def _fill_up(self, values: np.ndarray, fill: float = 0.0) -> np.ndarray:
        """Sort values (…, n, channels) by channel, levels side by side and filled up to whole vectors, (…, channels, width)."""
        turned = np.swapaxes(values, -1, -2)
        full = np.full((*turned.shape[:-1], self._width), fill)
        full[..., : self.layout.levels] = turned
        return full

    def equip(self, stages: Sequence[Sequence[Numbers]], **devices: float) -> None:
        """Give the devices what they begin with.

        Args:
            stages: of the regulators, of the muscles' pressures, of the tensions, along the edges, around the tip.
            devices: fields of the C struct.
        """
        self.rig.stages = self._keep("stages", np.array([len(group) for group in stages], dtype=np.int64))
        for name, group in zip(("regulators", "muscles", "tendons", "along", "around"), stages, strict=True):
            made = (_Stage * len(group))()
            for k, (stage, each) in enumerate(zip(made, group, strict=True)):
                stage.kind, stage.count = KINDS.index(each.kind), each.count
                parts = [self._fill_up(part, 1.0) for part in each.channels] if name == "along" else each.channels
                stage.numbers = self._keep(
                    f"{name} {k}", np.concatenate([np.array(each.scalars, dtype=float), *(p.ravel() for p in parts)])
                )
            self._groups[name] = made
            setattr(self.rig, name, ctypes.addressof(made))
        for name, value in devices.items():
            setattr(self.rig, name, value)

    def shake(self, sines: np.ndarray, began: float) -> None:
        """Move the base, as by `Imperfection.base_motion`, from a time in the session in s."""
        self.rig.shaking, self.rig.sines, self.rig.began = self._keep("shaking", sines), len(sines), began

    def monitors(self, pressure: np.ndarray, tension: np.ndarray) -> None:
        """Set what the monitors measure, (modules · actuators,) in Pa and N."""
        self._kept["pressure"][:], self._kept["tension"][:] = pressure, tension

    def record(self, at: np.ndarray, commands: Timeline, forces: Timeline) -> tuple[int, list[np.ndarray]]:
        """Advance to each of some steps.

        Args:
            at: steps, (frames,), int64.
            commands: (3 · actuators,).
            forces: (points, 3).

        Returns:
            How many steps were reached before the network left all bounds; nodes, points, pressures and tensions at all of them.
        """
        for c, timeline, size in zip(self._timelines, (commands, forces), (3 * self.count, 3 * self.layout.points), strict=True):
            first, (steps, values, slopes, moves) = timeline.first, timeline.addresses
            c.knots, c.size = timeline.end - first, size
            c.at, c.values, c.slopes, c.moves = steps + 8 * first, values + 8 * size * first, slopes + 8 * size * first, moves + first
        frames = len(at)
        ends = [frames * end for end in self._ends]
        found = np.empty(ends[-1])
        base = found.ctypes.data
        starts = [base, *(base + 8 * end for end in ends[:-1])]
        done = self._library.record(self._at, *self._timelines_at, frames, at.ctypes.data, *starts)
        parts = zip([0, *ends], ends, self._shapes, strict=False)
        return done, [found[start:end].reshape(frames, *shape) for start, end, shape in parts]

    def load(self, forces: np.ndarray) -> None:
        """See `Network`."""
        self._library.carry(self._at, np.ascontiguousarray(forces).ctypes.data)

    @property
    def nodes(self) -> np.ndarray:
        """See `Network`."""
        return self._rows("x")

    @property
    def velocities(self) -> np.ndarray:
        """See `Network`."""
        return self._rows("v")

    def _rows(self, name: str) -> np.ndarray:
        return self._kept[name][:, :, LANES - 1 : LANES + self.layout.levels].transpose(2, 0, 1).copy()

    def place(self, position: np.ndarray) -> None:
        """See `Network`."""
        x, n = self._kept["x"], self.layout.levels
        x[:] = self._kept["rest"]
        x[:, :, LANES : LANES + n] += position.reshape(n, -1, 3).transpose(1, 2, 0)
        self._kept["v"][:] = 0.0

    def forces_at_rest(self, positions: np.ndarray, push: np.ndarray) -> np.ndarray:
        """See `Network`."""
        forces, place, motors = np.empty_like(positions), np.ascontiguousarray(positions), self._fill_up(push)
        self._library.force_at_rest(self._at, len(place), place.ctypes.data, motors.ctypes.data, forces.ctypes.data)
        return forces
