"""Parameters of plant files: ranges, priors, and values that groups of runs have for themselves."""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.problem.parameters import MachineDescription
from tepm_opt.errors import InputError
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.mechanics.plant import Free

TIME = np.linspace(0, 2, 81)


def swing(groups: tuple[str, ...] = ("empty", "loaded")) -> CasadiPlant:
    m = Equations("a swing", laws=())
    q, v = m.state("q"), m.state("v")
    spring = m.parameter("spring", 30.0, "N/m", std=3.0)
    mass, damper = m.parameter("mass", 1.0, "kg", within=0.9, groups=groups), m.parameter("damper", 1.0, "N s/m")
    m.rate(q, v)
    m.rate(v, (m.input("force", size=10.0) - spring * q - damper * v) / mass)
    m.output("position", q, "m")
    return m.plant()


def run(group: str, points: np.ndarray | None = None) -> Run:
    force = np.where(TIME < 0.5, 0.0, 10.0)[:, None]
    points = np.zeros((len(TIME), 1, 1)) if points is None else points
    return Run(f"{group}.csv", "fit", TIME, force, np.zeros((len(TIME), 3)), points, group=group)


def test_equations_have_parameters_of_groups_of_runs() -> None:
    plant = swing()
    assert plant.known == ("spring", "mass[empty]", "mass[loaded]", "damper")
    truth = plant.with_values({"mass[empty]": 0.8, "mass[loaded]": 1.6, "spring": 28.0, "damper": 1.1})
    runs = tuple(run(group, truth.predict(run(group)).points) for group in ("empty", "loaded"))
    for mass, each in zip((0.8, 1.6), runs, strict=True):
        pushed = TIME[TIME >= 0.5]
        found = solve_ivp(lambda t, y, m=mass: [y[1], (10 - 28 * y[0] - 1.1 * y[1]) / m], (0.4875, 2), [0, 0], t_eval=pushed, rtol=1e-8)
        np.testing.assert_allclose(each.points[TIME >= 0.5, 0, 0], found.y[0], atol=1e-3)  # the force rises within a sample
    by = plant.predict(runs[0], plant.known).by
    assert not by[2].any()
    assert all(by[k].any() for k in (0, 1, 3))
    assert identify(Problem(plant, runs, plant.free(plant.known), 1e-4)).named == pytest.approx(truth.values, rel=1e-3)
    with pytest.raises(InputError, match=r"full.csv: mass: unknown group 'full': .*valid: empty, loaded"):
        plant.predict(run("full"))


def test_the_order_of_parameters_does_not_matter() -> None:
    """Each derivative is the change with its own parameter, with groups declared between others."""
    plant = swing()
    for group in ("empty", "loaded"):
        found = plant.predict(run(group), plant.known)
        for name, slope in zip(plant.known, found.by, strict=True):
            moved = plant.with_values({name: plant.values[name] + 1e-5}).predict(run(group)).points
            np.testing.assert_allclose((moved - found.points) / 1e-5, slope, atol=1e-4)


def known(*args: Any, **kwargs: Any) -> list[Free]:
    """Parameters that a machine gets."""
    machine = MachineDescription("a machine")
    machine.parameter(*args, **kwargs)
    return list(machine._free.values())


def test_ranges_and_priors() -> None:
    (free,) = known("a", 2.0, "m")
    assert (free.low, free.high, free.prior_std) == (1.6, 2.4, inf)
    (free,) = known("a", 2.0, "m", std=0.5)
    assert (free.low, free.high, free.scale, free.prior_mean, free.prior_std) == (-3.0, 7.0, 0.5, 2.0, 0.5)
    (free,) = known("a", 2.0, "m", std=0.5, low=0.0, high=inf)
    assert (free.low, free.high, free.spread) == (0.0, inf, 0.5)
    assert [each.name for each in known("a", 2.0, groups=("x", "y"))] == ["a[x]", "a[y]"]
    with pytest.raises(InputError, match="a = 2 m is outside its range; valid: 0 … 1"):
        known("a", 2.0, "m", low=0, high=1)
    with pytest.raises(InputError, match="a has no range"):
        known("a", 0.0)


def test_the_old_name_of_a_parameter_warns() -> None:
    machine = MachineDescription("a machine")
    with pytest.warns(DeprecationWarning, match=r"m\.known\(…\) is now m\.parameter\(…\)"):
        machine.known("a", 2.0, "m")
    assert list(machine._free) == ["a"]
