"""A tapered silicone tentacle that hangs and is bent by two tendons, in equilibrium: four markers as seen from the one at its base.

Its length is known, all else within reason only. The markers stand off the body; it was mounted twice, and each mounting has its own base
and places of the markers. What is over EI, the bending stiffness at the base, shows in positions; stiffness by itself does not.
"""

import numpy as np

from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.callable_plant import Simulator
from tepm_opt.discrepancy.laws.bodies import BODIES
from tepm_opt.discrepancy.laws.rod import equilibrium
from tepm_opt.discrepancy.laws.tendons import TENDONS

LENGTH, PIECES = 0.36, 18  # m
ALONG = (np.arange(PIECES) + 0.5) / PIECES
AXES = ("x", "y", "z")  # z down
STATIONS = {"p1": 0.33, "p2": 0.58, "p3": 0.79, "p4": 1.0}  # of the markers, in parts of the length

m = Simulator("tentacle", Signals.from_names(["tension_1", "tension_2"], list(STATIONS), "m", axes=AXES))
for k, direction in enumerate((0.5, 2.5)):
    m.parameter(f"bend_{k + 1}", 1.0, "1/(N m)", low=0.1, high=10)  # radius on which the tendon runs, over EI
    m.parameter(f"direction_{k + 1}", direction, "rad", low=direction - 1, high=direction + 1)
m.parameter("taper", 0.4, low=0.0, high=0.85)
m.parameter("weight", 50.0, "1/m2", low=0.0, high=400)  # over EI
m.parameter("shortening", 0.003, "1/N", low=0.0, high=0.03)
own = [(f"base_{axis}", 0.0, "m", 0.04) for axis in AXES] + [(f"tilt_{axis}", 0.0, "rad", 0.3) for axis in "xy"]
own += [(f"station_{p}", station, "1", 0.08) for p, station in STATIONS.items()]
own += [(f"aside_{p}_{axis}", 0.0, "m", 0.02) for p in STATIONS for axis in "xy"]
for name, value, unit, std in own:
    m.parameter(name, value, unit, std=std, groups=("first", "second"))
tendons = [m.effects(TENDONS, f"tension_{k}", "N", signal=8.0) for k in (1, 2)]
laws = {law.name: law for law in BODIES}
routing, stiffness = m.effects([laws["taper"]], "routing"), m.effects([laws["stiffness_along"]], "body")
rest = [m.effects([laws["rest_curvature"]], axis, "rad/m", signal=10.0) for axis in "xy"]


def simulate(run, values):
    """The markers, (sets, rows, 4, 3) in m."""
    long = {name: value[:, None, None] for name, value in values.items()}
    flat = {name: value[:, None] for name, value in values.items()}
    tension, thick = run.inputs.T[:, None, :, None], 1 - long["taper"] * ALONG
    stiff = stiffness(long, thick**4, along=ALONG)

    def pulls(turned):
        bends = [long[f"bend_{k + 1}"] * tendons[k](long, tension[k], turned=turned) for k in (0, 1)]
        way, on = (long["direction_1"], long["direction_2"]), routing(long, thick, along=ALONG)
        x, y = (on * (bends[0] * wave(way[0]) + bends[1] * wave(way[1])) for wave in (np.sin, np.cos))
        return np.stack([rest[0](long, 0.0) * stiff - x, rest[1](long, 0.0) * stiff + y])

    weight = long["weight"] * thick**2 / np.sum(thick**2, axis=-1, keepdims=True)
    steps = LENGTH / PIECES * np.maximum(1 - long["shortening"] * tension.sum(axis=0) / thick**2, 0.1)
    tilt = np.stack([flat["tilt_x"], flat["tilt_y"], 0 * flat["tilt_x"]])
    body, base = equilibrium(pulls, stiff, weight, steps, tilt), np.stack([flat[f"base_{axis}"] for axis in AXES])
    markers = [base + body.point_at(flat[f"station_{p}"], flat[f"aside_{p}_x"], flat[f"aside_{p}_y"]) for p in STATIONS]
    return np.moveaxis(np.stack(markers, axis=-1), 0, -1)


plant = m.plant(simulate, static=True, many=True)
