"""Made data of a linear drive and of a two-link arm, simulated by SciPy from equations of motion written down apart from the plants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from tepm_opt.data.tables import write_columns

STEP = 0.01  # s
SHARP = 5e-3  # m/s or rad/s at which dry friction is three quarters of itself
Columns = Mapping[str, np.ndarray]


def written(folder: Path, noise: Mapping[str, float], runs: Mapping[str, Columns], start: str, more: str = "") -> Path:
    """A data set whose last run is the validation run."""
    folder.mkdir(parents=True, exist_ok=True)
    roles = ["fit"] * (len(runs) - 1) + ["validation"]
    entries = "\n".join(f'  {{ file = "{name}.csv", role = "{role}" }},' for name, role in zip(runs, roles, strict=True))
    sigmas = "\n".join(f"{name} = {sigma}" for name, sigma in noise.items())
    text = f'name = "{folder.name}"\nstart = "{start}"\n{more}runs = [\n{entries}\n]\n[noise]\n{sigmas}\n'
    (folder / "dataset.toml").write_text(text, encoding="utf-8")
    for name, columns in runs.items():
        write_columns(folder / f"{name}.csv", columns)
    return folder


def wave(random: np.random.Generator, size: float, frequencies: tuple[float, ...]) -> Callable[[np.ndarray | float], np.ndarray]:
    """A sum of sines that begins at 0."""
    sizes, w = random.uniform(0.5, 1.0, len(frequencies)), 2 * np.pi * np.array(frequencies) * random.uniform(0.9, 1.1, len(frequencies))
    return lambda t: size * np.sin(np.multiply.outer(t, w)) @ sizes / len(frequencies)


def drive_runs(
    friction: float = 0.0, offset: float = 0.0, mass: float = 10.4, viscous: float = 45.0, seconds: float = 8.0
) -> dict[str, Columns]:
    """A carriage that a controller moves back and forth: the motor's force and the position."""
    random, found = np.random.default_rng(7), {}
    for k in range(4):
        asked = wave(random, 0.4, (0.25, 0.6, 1.3))

        def force(t: np.ndarray | float, x: np.ndarray, asked: Callable[[np.ndarray | float], np.ndarray] = asked) -> np.ndarray:
            return 2000 * (asked(t) - x[0]) - 250 * x[1]

        def rates(t: float, x: np.ndarray, held: float) -> list[float]:
            return [x[1], (held - viscous * x[1] - friction * np.tanh(x[1] / SHARP) + offset) / mass]

        time, x, rows = np.arange(0, seconds, STEP), np.zeros(2), []
        for t in time:  # the controller holds its force from sample to sample
            held = float(force(t, x))
            rows.append((held, x[0]))
            x = solve_ivp(rates, (t, t + STEP), x, "LSODA", args=(held,), rtol=1e-8, atol=1e-10).y[:, -1]
        pushed, at = np.array(rows).T
        found[f"run{k}"] = {"time_s": time, "force": pushed, "encoder": at + random.normal(0, 1e-4, len(time))}
    return found


def arm_runs(friction: float = 0.0, seconds: float = 6.0) -> dict[str, Columns]:
    """An arm that hangs and is swung by torques at both joints; friction is in the elbow."""
    random, found = np.random.default_rng(11), {}
    for k in range(4):
        one, two = wave(random, 3.0, (0.4, 0.9, 1.7)), wave(random, 1.0, (0.5, 1.1, 2.3))

        def rates(t: float, x: np.ndarray, one=one, two=two) -> np.ndarray:
            """Lagrange's equations with Cartesian Jacobians of both centres: M = Σ m Jᵀ J + I, forces from the rates of J."""
            (a, b), w = x[:2], x[2:]
            (m_1, m_2), total = (1.55, 0.96), a + b
            j_1 = 0.2 * np.array([[np.cos(a), 0], [np.sin(a), 0]])
            j_2 = np.array(
                [
                    [0.4 * np.cos(a) + 0.15 * np.cos(total), 0.15 * np.cos(total)],
                    [0.4 * np.sin(a) + 0.15 * np.sin(total), 0.15 * np.sin(total)],
                ]
            )
            spin = w[0] + w[1]
            bent_1 = 0.2 * w[0] ** 2 * np.array([-np.sin(a), np.cos(a)])  # J̇ q̇, the centripetal acceleration
            bent_2 = 0.4 * w[0] ** 2 * np.array([-np.sin(a), np.cos(a)]) + 0.15 * spin**2 * np.array([-np.sin(total), np.cos(total)])
            turn = np.array([[1.0, 0.0], [1.0, 1.0]])  # rates of both links by those of the joints
            inertia = m_1 * j_1.T @ j_1 + m_2 * j_2.T @ j_2 + turn.T @ np.diag([0.02, 0.0075]) @ turn
            down = np.array([0.0, 9.81])
            bent = m_1 * j_1.T @ (bent_1 + down) + m_2 * j_2.T @ (bent_2 + down)
            torque = np.array([float(one(t)), float(two(t))]) - 0.08 * w - np.array([0.0, friction * np.tanh(w[1] / SHARP)])
            return np.concatenate([w, np.linalg.solve(inertia, torque - bent)])

        time = np.arange(0, seconds, STEP)
        x = solve_ivp(rates, (0, seconds), np.zeros(4), "LSODA", time, rtol=1e-8, atol=1e-10).y
        noisy = x[:2] + random.normal(0, 1e-3, (2, len(time)))
        found[f"run{k}"] = {"time_s": time, "torque_1": one(time), "torque_2": two(time), "angle_1": noisy[0], "angle_2": noisy[1]}
    return found


def drive(folder: Path, friction: float = 0.0, offset: float = 0.0) -> Path:
    """A data set of the drive."""
    return written(folder, {"encoder": 1e-4}, drive_runs(friction, offset), "free", "piece_s = 2.0\n")


def arm(folder: Path, friction: float = 0.0) -> Path:
    """A data set of the arm, which begins at rest."""
    return written(folder, {"angle_1": 1e-3, "angle_2": 1e-3}, arm_runs(friction), "equilibrium")
