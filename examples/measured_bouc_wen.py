"""Data set of a simulated benchmark with a published formula (Noël and Schoukens 2016): a mass on a spring with a memory, made here."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tepm_opt.data.tables import write_columns

MASS, DAMPER, SPRING = 2.0, 10.0, 5e4  # kg, N s/m, N/m
ALPHA, BETA, GAMMA, DELTA = 5e4, 1e3, 0.8, -1.1  # N/m, 1/m, 1, 1
RATE, FINER, ROWS = 750, 20, 2048  # Hz; steps a sample; samples of a period
BAND, FORCE, NOISE = (5.0, 150.0), 50.0, 8e-6  # Hz, N r.m.s., m
DESCRIPTION = """name = "Bouc-Wen"
runs = [
  { file = "0.csv", role = "fit" },
  { file = "1.csv", role = "fit" },
  { file = "2.csv", role = "fit" },
  { file = "3.csv", role = "validation" },
]
[noise]
position = 8e-6
"""


def bouc_wen(shared: Path, out: Path) -> None:
    """Random-phase multisines from rest; nothing of the shared folder is needed."""
    out.mkdir(parents=True, exist_ok=True)
    for k in range(4):
        random = np.random.default_rng(k)
        force = np.concatenate([np.zeros(8 * FINER), multisine(random)])
        position = motion(force)
        rows = len(position)
        columns = {"time_s": np.arange(rows) / RATE, "force": force[::FINER][:rows], "position": position + random.normal(0, NOISE, rows)}
        write_columns(out / f"{k}.csv", columns)
    (out / "dataset.toml").write_text(DESCRIPTION, encoding="utf-8")


def multisine(random: np.random.Generator) -> np.ndarray:
    """One period in steps of the integration, in N."""
    hertz = np.fft.rfftfreq(ROWS, 1 / RATE)
    spectrum = np.zeros(ROWS * FINER // 2 + 1, complex)
    inside = np.flatnonzero((hertz >= BAND[0]) & (hertz <= BAND[1]))
    spectrum[inside] = np.exp(2j * np.pi * random.random(len(inside)))
    force = np.fft.irfft(spectrum, ROWS * FINER)
    return FORCE * force / force.std()


def motion(force: np.ndarray) -> np.ndarray:
    """Displacement in m at the samples, by Runge and Kutta's steps of 1/15000 s."""

    def rates(x: np.ndarray, f: float) -> np.ndarray:
        q, v, z = x
        return np.array([v, (f - DAMPER * v - SPRING * q - z) / MASS, ALPHA * v - BETA * (GAMMA * abs(v) * z + DELTA * v * abs(z))])

    h, x, found = 1 / (RATE * FINER), np.zeros(3), []
    for k in range(len(force) - 1):
        if k % FINER == 0:
            found.append(x[0])
        first, last = force[k], force[k + 1]
        k_1 = rates(x, first)
        k_2 = rates(x + h / 2 * k_1, (first + last) / 2)
        k_3 = rates(x + h / 2 * k_2, (first + last) / 2)
        x = x + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + rates(x + h * k_3, last))
    return np.array(found)
