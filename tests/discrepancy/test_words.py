"""What the workflow tells in words."""

from __future__ import annotations

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.network import candidate
from tepm_opt.discrepancy.verdict import Named, Value
from tepm_opt.discrepancy.words import _names, _values, repeats


def run(file: str, seed: int, pressure: float) -> Run:
    points = np.random.default_rng(seed).normal(0, 1e-3, (500, 4, 3))
    return Run(file, "fit", np.arange(500) / 50, np.full((500, 12), pressure), np.zeros((500, 3)), points)


def test_repeated_runs_tell_the_repeatability() -> None:
    lines = repeats([run("a.csv", 1, 1e5), run("b.csv", 2, 1e5), run("c.csv", 3, 2e5)], 1e-3)
    assert lines == ["a.csv and b.csv repeat the same inputs: 1.73 mm each (noise alone: 1.73 mm)."]


def test_long_times_are_in_seconds() -> None:
    """Small units are for small values."""

    def told(seconds: float) -> str:
        return _values(Named(candidate("time_delay"), 1.0, {"delay": Value(seconds, 0.002, "s", 0.0)}, 1.0))

    assert told(0.03) == "delay 30 ± 2 ms"
    assert told(30.4) == "delay 30.4 ± 0.002 s"


def test_many_effects_are_listed_without_their_sizes() -> None:
    """A dozen sizes in one sentence is nothing that anybody reads."""
    names = ("time_delay", "payload", "base_tilt", "tendon_friction")
    named = [
        Named(candidate(name), p, {"size": Value(1.0, 0.1, "1", 0.0)}, 1.0) for name, p in zip(names, (1.0, 0.9, 0.8, 0.4), strict=True)
    ]
    assert _names(named[:2]) == "time_delay (size 100 ± 10 %; probability 1.00) and payload (size 100 ± 10 %; probability 0.90)"
    listed = "time_delay (1.00), payload (0.90), base_tilt (0.80); perhaps also tendon_friction (0.40)"
    assert _names(named) == f"4 effects, with their probabilities: {listed}"
