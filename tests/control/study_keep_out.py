"""True least distances to obstacles on random machines: `python -m tests.control.study_keep_out SEED MACHINES` prints them in mm.

A lamp beside the circle in 8 s, which cuts 10 mm into it, and a ball 5 mm beside the elbow of an arm whose tip is pushed with 0.3 N.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from tepm_opt.control.collision.elastic_band import detour
from tepm_opt.control.collision.geometry import ObstacleFile, Obstacles, SphereObstacle
from tepm_opt.control.collision.model import CollisionModel
from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.reference import Reference, approach, reference_of
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rig import SimulatedRig
from tests.control.study import model, reference

LAMP = SphereObstacle(name="lamp", centre_m=(-0.085, 0.1472, 0.35), radius_m=0.03)
MARGIN = 0.005  # m


class Pushed(SimulatedRig):
    """A machine whose tip is pushed along x with 0.3 N for a second and a half, from 3 s on."""

    def read(self) -> Sample:
        """As of the rig, pushed."""
        self.push(np.array([0.3 if 3.0 <= self.time < 4.5 else 0.0, 0.0, 0.0]))
        return super().read()


def beside(*obstacles: SphereObstacle, margin: float = MARGIN) -> CollisionModel:
    """Obstacles beside the nominal arm."""
    return CollisionModel(model(), Obstacles(ObstacleFile(margin_m=margin, spheres=obstacles)))


def ways(path: Reference, keep_out: CollisionModel, led: bool) -> dict[str, tuple[Reference, Reference]]:
    """What the controller follows and what the loop logs by: nothing known of the obstacles, the path led round them, the rows as well."""
    round_them = detour(model(), path, keep_out)
    found = {"nothing": (path, replace(path, keep_out=keep_out))}
    found |= {"path led": (replace(round_them, keep_out=None), round_them)} if led else {}
    return {**found, "everything": (round_them, round_them)}


def least(rig: SimulatedRig, known: Reference, logged: Reference, after: int) -> tuple[float, float]:
    """True least distance from a sample on, and the true tip's error, in mm."""
    controller = Mpc(model(), known)
    controller.reference = logged
    done = close_loop(rig, controller, model().robot)
    return 1e3 * min(done.distance[after:]), 1e3 * done.error()


def main(seed: int, machines: int) -> None:
    """Print a line for every machine, and the means and the worst."""
    lead = approach(model(), np.array([0.15, 0.0, 0.35]), 2.0)
    held = reference_of(model(), np.vstack([lead, np.repeat(lead[-1:], 350, axis=0)]))
    elbow = held.equilibria[-1].points[1]
    ball = SphereObstacle(name="ball", centre_m=(float(elbow[0]) + 0.025, float(elbow[1]), float(elbow[2])), radius_m=0.02)
    cases = {
        "lamp": (SimulatedRig, ways(reference("circle"), beside(LAMP), True), 0),
        "ball": (Pushed, ways(held, beside(ball, margin=0.003), False), 250),
    }
    for name, (kind, each, after) in cases.items():
        table = []
        for number in range(machines):
            row = []
            for known, logged in each.values():
                rig = kind(random_machine("kang2017", seed, number))
                rig.reseed(1)
                row.append(least(rig, known, logged, after))
            table.append(row)
            print(f"{name} machine {number:2d}: {np.round(row, 2).tolist()}", flush=True)
        distance, error = np.moveaxis(np.array(table), 2, 0)
        told = zip(each, distance.mean(axis=0), distance.min(axis=0), error.mean(axis=0), strict=True)
        for way, mean, worst, off in told:
            print(f"{name}, {way}: least distance mean {mean:.2f}, worst {worst:.2f}; error {off:.2f}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
