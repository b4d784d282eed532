"""Causes outside the library of effects: foreign in place or in variables. No name is right for any of them.

What each is, and why no effect does it (docs/results/blind.md has the same list):

| cause | what acts | foreign in |
| --- | --- | --- |
| curved_field | the tracker's frame bends with the square of the position | variables: an error of position that grows with position² |
| metal_nearby | points are drawn towards a piece of metal | variables: an error that depends on the distance from a place |
| sagging_supply | all pressures fall as the consumption of all muscles rises | place: between all muscles of both modules |
| slew_limit | a regulator changes its pressure at most at a rate | form: no error while slow, no time constant when fast |
| filtered_point | one tracked point is low-pass filtered | place: memory behind one sensor |
| loose_marker | one tracked point follows within play | place: hysteresis behind one sensor |
| soft_module | one module's edges are softer than the other's | place: stiffness of half the robot |
| soft_level | the edges of one segment are softer | place: stiffness of one level |
| twisted_body | muscles and diagonals are mounted helically | place: torsion |
| rippled_regulator | pressure errs with a sine of the pressure | variables: periodic in pressure |
| pinched_tendons | a bladder under pressure takes tension off its own tendon | variables: tension times pressure |
| crossed_modules | pressure in a lower muscle leaks into the one above it | place: from module to module |
| tip_wall | the tip leans on a wall where it comes too far | variables: one-sided force by place |
| tied_hose | a hose pulls the tip like a spring to where it is tied | variables: force by place |
| tip_drag | the tip is dragged through a fluid | variables: force by the square of velocity |
| wrong_load_cell | known tip forces are weaker or stronger than recorded | place: the known load |
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.studies.blind.causes import POINTS, Cause, Form, direction, make_setpoint_change
from tepm_opt.studies.blind.machine import Deviation, Sight

Pair = tuple[np.ndarray, np.ndarray]
Change = Callable[[float, np.ndarray, np.ndarray, np.ndarray], Pair]
"""Pressures and tensions that act, from a size, time (rows,), and pressures and tensions commanded, (rows, 6) in Pa and N."""


def _make_sight_cause(usual: float, low: float, high: float, drawn: Callable[[np.random.Generator], Callable[[float], Sight]]) -> Cause:
    """Make a cause that acts on measured points.

    Args:
        usual, low, high: sizes, see `Form`.
        drawn: what becomes of the points at a size.
    """

    def cause(random: np.random.Generator) -> Form:
        sight = drawn(random)
        return Form((), lambda size: Deviation(after=sight(size)), usual, low, high)

    return cause


def _make_command_cause(
    usual: float,
    low: float,
    high: float,
    drawn: Callable[[np.random.Generator], Change],
) -> Cause:
    """Make a cause that acts on commands, before the actuators.

    Args:
        usual, low, high: sizes, see `Form`.
        drawn: pressures and tensions at a size, from it, time, pressures and tensions.
    """

    def cause(random: np.random.Generator) -> Form:
        change = drawn(random)
        return Form((), lambda size: Deviation(before=make_setpoint_change(lambda *asked: change(size, *asked))), usual, low, high)

    return cause


def _make_rig_cause(
    name: str, usual: float, low: float, high: float, settings: Callable[[np.random.Generator], Callable[[float], dict]]
) -> Cause:
    """Make a cause that is an imperfection of the rig.

    Args:
        name: of the imperfection.
        usual, low, high: sizes, see `Form`.
        settings: drawn; the imperfection's settings at a size.
    """

    def cause(random: np.random.Generator) -> Form:
        at = settings(random)
        return Form((), lambda size: Deviation({name: at(size)}), usual, low, high)

    return cause


def _curved_field(random: np.random.Generator) -> Callable[[float], Sight]:
    bends = random.normal(size=(3, 3, 3))  # of each axis, with the products of two

    def make_sight(size: float) -> Sight:
        def bend_field(time: np.ndarray, points: np.ndarray) -> np.ndarray:
            away = points - np.array([0.0, 0.0, 0.15])
            return points + size * np.einsum("rpi,ijk,rpk->rpj", away, bends, away)

        return bend_field

    return make_sight


def _filtered_point(random: np.random.Generator) -> Callable[[float], Sight]:
    which = int(random.integers(len(POINTS)))

    def make_sight(size: float) -> Sight:
        def filter_point(time: np.ndarray, points: np.ndarray) -> np.ndarray:
            found = points.copy()
            for k, (seconds, now) in enumerate(zip(np.diff(time), points[1:, which], strict=True)):
                found[k + 1, which] = now + (found[k, which] - now) * np.exp(-seconds / size)
            return found

        return filter_point

    return make_sight


def _loose(random: np.random.Generator) -> Callable[[float], Sight]:
    which = int(random.integers(len(POINTS)))

    def make_sight(size: float) -> Sight:
        def hold_back_point(time: np.ndarray, points: np.ndarray) -> np.ndarray:
            found = points.copy()
            for last, now in pairwise(found[:, which]):
                away = now - last
                now[:] = now - away * min(1.0, size / max(np.linalg.norm(away), 1e-12))
            return found

        return hold_back_point

    return make_sight


def _slew_limit(random: np.random.Generator) -> Change:
    def change(size: float, time: np.ndarray, pressures: np.ndarray, tensions: np.ndarray) -> Pair:
        found, most = pressures.copy(), np.diff(time) / size
        for seconds, (last, now) in zip(most, pairwise(found), strict=True):
            now[:] = last + np.clip(now - last, -seconds, seconds)
        return found, tensions

    return change


def _pinched_tendons(random: np.random.Generator) -> Change:
    return lambda size, time, pressures, tensions: (pressures, tensions * np.exp(-size * pressures / 1e5))


def _sagging_supply(random: np.random.Generator) -> Change:
    power = random.uniform(1.2, 2.5)

    def change(size: float, time: np.ndarray, pressures: np.ndarray, tensions: np.ndarray) -> Pair:
        sag = size * (pressures.mean(axis=1, keepdims=True) / 0.3e6) ** power
        return pressures * (1 - np.minimum(sag, 0.5)), tensions

    return change


def _rippled_regulator(random: np.random.Generator) -> Change:
    period, phase = random.uniform(30e3, 80e3), random.uniform(0, 2 * np.pi, 6)
    return lambda size, time, pressures, tensions: (
        pressures + size * (np.sin(2 * np.pi * pressures / period + phase) - np.sin(phase)),
        tensions,
    )


def _crossed_modules(random: np.random.Generator) -> Change:
    mixing = np.eye(6), np.eye(6, k=3)
    return lambda size, time, pressures, tensions: (pressures @ (mixing[0] + size * mixing[1]), tensions)


def _load_cell(random: np.random.Generator) -> Form:
    sign = float(random.choice([-1, 1]))

    def deviate_by(size: float) -> Deviation:
        return Deviation(before=lambda asked: SetPoints(asked.time, asked.inputs, (1 + sign * size) * asked.tip_force))

    return Form((), deviate_by, 0.1, 1e-3, 0.6)


def _metal(random: np.random.Generator) -> Callable[[float], dict]:
    place = np.array([0.0, 0.0, 0.2]) + np.array([0.3, 0.3, 0.15]) * direction(random)
    return lambda size: {"size_m": size, "metal_m": tuple(place), "reach_m": 0.2}


def _softer(random: np.random.Generator) -> Callable[[float], dict]:
    first = 1 + 6 * int(random.integers(2))
    return lambda size: {"loss": size, "first": first, "last": first + 5}


def _weak_level(random: np.random.Generator) -> Callable[[float], dict]:
    level = int(random.integers(2, 12))
    return lambda size: {"loss": size, "first": level, "last": level}


def _twisted_body(random: np.random.Generator) -> Callable[[float], dict]:
    hand = float(random.choice([-1, 1]))
    return lambda size: {"strain": hand * size}


def _wall(random: np.random.Generator) -> Callable[[float], dict]:
    toward = np.append(direction(random, 2), 0.0)
    place = random.uniform(0.01, 0.05) * toward
    same = {"place_m": tuple(place), "normal": tuple(-toward)}
    return lambda size: {"stiffness_N_per_m": size, "damping_N_s_per_m": min(0.02 * size, 1.0), **same}


def _hose(random: np.random.Generator) -> Callable[[float], dict]:
    place = np.array([0.0, 0.0, 0.38]) + 0.03 * direction(random)
    return lambda size: {"stiffness_N_per_m": size, "place_m": tuple(place)}


FOREIGN: dict[str, Cause] = {
    "curved_field": _make_sight_cause(0.1, 1e-3, 3.0, _curved_field),
    "metal_nearby": _make_rig_cause("field_distortion", 0.01, 1e-4, 0.1, _metal),
    "sagging_supply": _make_command_cause(0.1, 1e-3, 1.0, _sagging_supply),
    "slew_limit": _make_command_cause(2e-6, 5e-8, 5e-5, _slew_limit),
    "filtered_point": _make_sight_cause(0.03, 1e-3, 1.0, _filtered_point),
    "loose_marker": _make_sight_cause(3e-3, 1e-4, 0.05, _loose),
    "soft_module": _make_rig_cause("soft_part", 0.1, 1e-3, 0.6, _softer),
    "soft_level": _make_rig_cause("soft_part", 0.2, 1e-3, 0.8, _weak_level),
    "twisted_body": _make_rig_cause("twisted_body", 0.01, 1e-4, 0.1, _twisted_body),
    "rippled_regulator": _make_command_cause(2e3, 50.0, 20e3, _rippled_regulator),
    "pinched_tendons": _make_command_cause(0.2, 1e-3, 3.0, _pinched_tendons),
    "crossed_modules": _make_command_cause(0.03, 1e-3, 0.5, _crossed_modules),
    "tip_wall": _make_rig_cause("tip_wall", 2.0, 1e-2, 500.0, _wall),
    "tied_hose": _make_rig_cause("tethered_tip", 0.1, 1e-3, 20.0, _hose),
    "tip_drag": _make_rig_cause("tip_drag", 0.1, 1e-3, 20.0, lambda random: lambda size: {"size_N_s2_per_m2": size}),
    "wrong_load_cell": _load_cell,
}
"""By key; none is a name of SPEC's vocabulary."""
