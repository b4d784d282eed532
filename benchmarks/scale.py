"""Many evaluations over workers: statics and G at random inputs, and what a million would take. `python -m benchmarks.scale`."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

from tepm_opt.jobs.executors import processes
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.solvers.linear.gain import solve_gain
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.numerics.parallel import each_done

CHUNK = 500
"""Evaluations that a piece of work makes: some tens of milliseconds, so that sending it costs nothing."""
PART = 0.5  # of the inputs' ranges, at most
MILLION = 1e6


@dataclass(frozen=True)
class Piece:
    """Evaluations at inputs drawn from a seed, each from rest; with G or without."""

    model: CompiledModel
    seed: int
    gain: bool


def evaluated(piece: Piece) -> tuple[int, float]:
    """How many of a piece's equilibria are stable, and the seconds of a core that it took."""
    random, solved, began = np.random.default_rng(piece.seed), 0, time.process_time()
    for part in PART * random.uniform(size=(CHUNK, piece.model.layout.inputs)):
        found = solve_statics(piece.model, part * piece.model.input_max)
        if found.solved:
            solved += 1
            if piece.gain:
                solve_gain(found)
    return solved, time.process_time() - began


@dataclass(frozen=True)
class Pace:
    """Evaluations of some workers: how many a second, how many a second of a core, how many of them are stable."""

    a_second: float
    a_core_second: float
    stable: int


def measured(model: CompiledModel, workers: int, pieces: int, gain: bool) -> Pace:
    """Evaluations by so many processes, once they have begun.

    Args:
        model: whose.
        workers: how many.
        pieces: of CHUNK evaluations.
        gain: whether G is computed, too.
    """
    with processes(workers) as executor:
        for _ in each_done(evaluated, [Piece(model, seed, gain) for seed in range(2 * workers)], executor):
            pass  # processes import and compile
        began = time.perf_counter()
        done = [result for _, result in each_done(evaluated, [Piece(model, seed, gain) for seed in range(pieces)], executor)]
        passed, count = time.perf_counter() - began, pieces * CHUNK
    return Pace(count / passed, count / sum(spent for _, spent in done), sum(stable for stable, _ in done))


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--evaluations", type=int, default=20_000)
    parser.add_argument("--robot", default="kang2017")
    asked = parser.parse_args()
    model, pieces = compile_model(asked.robot), max(asked.evaluations // CHUNK, 1)
    print("| evaluations | workers | a second | a second of a core | 10^6 take, of a core |\n| --- | --- | --- | --- | --- |")
    for gain in (False, True):
        for workers in asked.workers:
            pace = measured(model, workers, pieces, gain)
            what = f"{'statics and G' if gain else 'statics'}, from rest ({pace.stable} of {pieces * CHUNK} stable)"
            print(f"| {what} | {workers} | {pace.a_second:.0f} | {pace.a_core_second:.0f} | {MILLION / pace.a_core_second:.0f} s |")


if __name__ == "__main__":
    main()
