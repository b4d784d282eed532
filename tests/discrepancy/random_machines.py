"""Machines and data sets made at random: whatever people may write down, sensible or not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.data.tables import write_columns
from tepm_opt.discrepancy.adapters.callable_plant import CallablePlant, Simulator
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.laws.axis import AXIS
from tepm_opt.discrepancy.laws.effect import Law
from tepm_opt.discrepancy.laws.signals import INPUT, OUTPUT
from tepm_opt.discrepancy.laws.vessels import VESSEL
from tepm_opt.solvers.mechanics.plant import PredictionError

GROUPS = ("", "cold", "warm")


def some(random: np.random.Generator, laws: Sequence[Law], most: int) -> list[Law]:
    """A few of them."""
    return [laws[k] for k in sorted(random.choice(len(laws), min(int(random.integers(most + 1)), len(laws)), replace=False))]


def unit(random: np.random.Generator) -> float:
    """How large numbers are: mostly about 1, else huge or tiny."""
    return float(10 ** random.uniform(-9, 9)) if random.random() < 0.3 else 1.0


def machine(random: np.random.Generator) -> tuple[CasadiPlant | CallablePlant, float]:
    """A plant and a time step in s: axes with springs or without, lags, vessels, any number of inputs and outputs; or a static function."""
    time = float(10 ** random.uniform(-3, 3)) if random.random() < 0.3 else 1.0
    step = time * float(10 ** (random.uniform(-3, -1.3) if random.random() < 0.9 else random.uniform(-6, 2)))
    return (function(random) if random.random() < 0.2 else equations(random, time)), step


def equations(random: np.random.Generator, time: float) -> CasadiPlant:
    """Axes, lags and vessels in a chain, each driven by the inputs and by the one before."""
    size = unit(random)
    laws = [*some(random, INPUT, 2), *some(random, AXIS, 3), *some(random, VESSEL, 2), *some(random, OUTPUT, 2)]
    m = Equations("a machine", time=time, laws=laws)
    drives = [m.input(f"u{k}", size=1.0, limit=float(random.choice([np.inf, 2.0]))) for k in range(random.integers(4))]
    before = ca.SX(0)
    states = []
    for k in range(random.integers(4)):
        gain = m.parameter(f"gain_{k}", float(random.uniform(0.5, 2)), "1", within=float(random.uniform(0.01, 1.5)))
        into = gain * (sum(drives, ca.SX(0)) + before / size)
        kind = random.choice(["axis", "integrator", "lag", "vessel"])
        q = m.state(f"q{k}")
        if kind in ("axis", "integrator"):
            v = m.state(f"v{k}")
            stiffness = 20.0 if kind == "axis" else 0.0
            extra = m.axis(f"axis {k}", q, v, force=1.0, speed=0.3 * size / time, position=0.1 * size)
            m.rate(q, v)
            m.rate(v, (size * (into + extra) - stiffness * q) / time**2 - 2.0 * v / time)
        elif kind == "lag":
            m.rate(q, (size * into - q) / time)
        else:
            _ = m.vessel(f"vessel {k}", q, (size * into - ca.sqrt(ca.fmax(size * q, 1e-12 * size**2))) / time, size=size)
        states.append(q)
        before = q
    for k in range(random.integers(1, 4)):
        seen = states[random.integers(len(states))] if states else size * sum(drives, ca.SX(1))
        m.output(f"y{k}", seen, str(random.choice(["m", "rad", "V", ""])), size=0.1 * size)
    return m.plant(int(random.integers(1, 4)), str(random.choice(["line", "hold", "band"])))  # type: ignore[arg-type]


def function(random: np.random.Generator) -> CallablePlant:
    """A static map of the inputs, with a parameter that groups may have for themselves."""
    inputs, outputs, size = int(random.integers(1, 4)), int(random.integers(1, 4)), unit(random)
    signals = Signals.from_names([f"u{k}" for k in range(inputs)], [f"y{k}" for k in range(outputs)], "m")
    m = Simulator("a map", signals)
    m.parameter("slope", 2.0, "1", within=0.5, groups=GROUPS if random.random() < 0.5 else ())
    m.parameter("bend", 0.1, "1", within=0.9)
    stateless = [law for law in INPUT if not law.states and law.name != "input_dead_zone"]
    m.effects([law for law in stateless if "gain" in law.name or "offset" in law.name], "u0", signal=1.0)
    mixed = random.normal(size=(inputs, outputs))
    names = [candidate.parameters[0] for candidate in m._candidates]

    def simulate(run: Run, values: Mapping[str, float]) -> np.ndarray:
        u = run.inputs.copy()
        for name in names:
            u[:, 0] = u[:, 0] * (1 - values[name]) if name.endswith("loss") else u[:, 0] + values[name]
        return size * (values["slope"] * u + values["bend"] * u**2) @ mixed

    return m.plant(simulate, static=True)


def moving(random: np.random.Generator, time: np.ndarray, count: int) -> np.ndarray:
    """Inputs: sines, steps, noise, or constants."""
    columns = []
    for _ in range(count):
        kind, size = random.choice(["sine", "steps", "noise", "constant", "nothing"]), random.uniform(0.3, 2.0)
        span = max(float(np.ptp(time)), 1e-12)
        columns.append(
            {
                "sine": size * np.sin(2 * np.pi * random.uniform(1, 5) * (time - time[0]) / span),
                "steps": size * np.sign(np.sin(7.0 * (time - time[0]) / span)),
                "noise": random.normal(0, size, len(time)),
                "constant": np.full(len(time), size),
                "nothing": np.zeros(len(time)),
            }[str(kind)]
        )
    return np.array(columns).reshape(count, len(time)).T


def truth(random: np.random.Generator, plant: CasadiPlant | CallablePlant) -> CasadiPlant | CallablePlant:
    """The machine with other known parameters, often with an effect."""
    values = {}
    for name in plant.known:
        free = plant.free([name])[0]
        values[name] = float(random.uniform(free.low, free.high))
    if plant.candidates and random.random() < 0.6:
        candidate = plant.candidates[random.integers(len(plant.candidates))]
        values |= candidate.probes[random.integers(len(candidate.probes))]
    return plant.with_values(values)


def measured(random: np.random.Generator, plant: CasadiPlant | CallablePlant, run: Run) -> np.ndarray:
    """What the machine does, (rows, outputs); noise where it cannot."""
    try:
        state = None if run.start == "equilibrium" or not plant.states else np.zeros(len(plant.states))
        points = plant.predict(replace(run, state=state)).points[..., 0]
    except PredictionError:
        points = random.normal(size=(run.rows, len(plant.signals.points)))
    size = np.maximum(np.ptp(points, axis=0), 1e-3 * np.abs(points).max() + 1e-12)
    return points + random.normal(size=points.shape) * size * 10 ** random.uniform(-4, -1)


def data(random: np.random.Generator, plant: CasadiPlant | CallablePlant, step: float, folder: Path) -> Path:
    """A data set: any number of runs of any length, with what is missing in such files."""
    real, signals = truth(random, plant), plant.signals
    starts = ["equilibrium", "measured", "free"]
    common = str(random.choice(starts, p=[0.3, 0.2, 0.5]))
    entries, spread = [], np.zeros(len(signals.points))
    folder.mkdir(parents=True)
    for k in range(random.choice([1, 1, 2, 3, 5])):
        rows = int(random.choice([1, 2, 3, 20, 60, 150]))
        time = random.uniform(-5, 5) * step + step * np.arange(rows)
        if random.random() < 0.1:
            time = time + 0.3 * step * random.random(rows)
        own = str(random.choice(starts)) if random.random() < 0.2 else common
        group = str(random.choice(GROUPS))
        inputs = moving(random, time, len(signals.inputs))
        run = Run("x", "fit", time, inputs, np.zeros((rows, 3)), np.zeros((rows, len(signals.points), 1)), start=own, group=group)  # type: ignore[arg-type]
        seen = measured(random, real, run)
        spread = np.maximum(spread, np.ptp(seen, axis=0))
        missing = random.random()
        if missing < 0.3:
            seen[random.random(seen.shape) < random.choice([0.05, 0.5, 1.0])] = np.nan
        elif missing < 0.4:
            seen[:, random.integers(seen.shape[1])] = np.nan
        if inputs.size and random.random() < 0.01:
            inputs[random.integers(rows), random.integers(inputs.shape[1])] = random.choice([np.nan, np.inf])
        columns = {"time_s": time, **dict(zip(signals.inputs, inputs.T, strict=True)), **dict(zip(signals.points, seen.T, strict=True))}
        if random.random() < 0.01:
            columns.pop(str(random.choice(list(columns))))
        write_columns(folder / f"{k}.csv", {**columns, "remark": np.zeros(rows)})
        role = "fit" if k == 0 or random.random() < 0.7 else "validation"
        entries.append(f'  {{ file = "{k}.csv", role = "{role}", start = "{own}", group = "{group}" }},')
    noise = [max(float(s), 1e-12) * 10 ** random.uniform(-4, 0) for s in spread]
    lines = ['name = "made"', f'start = "{common}"', f"static = {str(plant.static).lower()}"]
    if all('start = "free"' in entry for entry in entries) and random.random() < 0.5:
        lines.append(f"piece_s = {float(np.clip(step * random.uniform(5, 100), 1e-6, 1e6)):.6g}")
    lines += ["runs = [", *entries, "]", "[noise]", *(f"{name} = {sigma:.6g}" for name, sigma in zip(signals.points, noise, strict=True))]
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder
