"""Whether the compiled step holds a rate beside the simulated rig: `python -m tests.control.study_rate HERTZ SECONDS [alone]`.

The rig goes on in another process, in real time; the controller's own waits for samples, answers, prepares, and lets the command line's
journal write (not with "alone"). Prints how many commands came after the next sample was due, quantiles of feedback and step, and the
machine's load.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from multiprocessing import Pipe, Process
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from tepm_opt.control.loop import LoopRecord, LoopStep, pause_garbage_collection
from tepm_opt.control.mpc.controller import Mpc, MpcSettings
from tepm_opt.control.references.reference import reference_of, sample_tips
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import load_rig_file
from tepm_opt.jobs.closed_loop import ClosedLoop, LoopSetup
from tepm_opt.jobs.mpc import _open_journal
from tepm_opt.solvers.planning.trajectories import circle
from tests.control.study import model

SPIN = 2e-4  # s before a sample is due, from which the simulation does not sleep


def rig_of(rate: float) -> SimulatedRig:
    """The virtual prototype with a tracker of another rate."""
    file = load_rig_file()
    return SimulatedRig(file.model_copy(update={"tracker": file.tracker.model_copy(update={"rate_hz": rate})}))


def simulate(pipe: Connection, rate: float, samples: int, first: Command) -> None:
    """Send a sample at each of its times, and take the newest command that has come."""
    rig = rig_of(rate)
    rig.apply(first)
    ready, late = rig.read(), 0
    pipe.send(None)
    began = time.perf_counter() + 0.5
    for k in range(samples):
        time.sleep(max(began + k / rate - time.perf_counter() - SPIN, 0.0))
        while time.perf_counter() < began + k / rate:
            pass
        late += time.perf_counter() > began + (k + 0.5) / rate
        pipe.send((ready, time.perf_counter()))
        while pipe.poll():
            rig.apply(pipe.recv())
        ready = rig.read()
    pipe.send(late)


def main(rate: float, seconds: float, journal: bool) -> None:
    """Print what came out."""
    period, samples = 1 / rate, round(rate * seconds)
    tips, counted = sample_tips(circle(400), laps=max(seconds - 2, 1) / 8, period=period)
    reference = reference_of(model(), tips[:samples], counted[:samples], period=period)
    controller = Mpc(model(), reference, MpcSettings(backend="c"))
    here, there = Pipe()
    rig = Process(target=simulate, args=(there, rate, samples, controller.start()), daemon=True)
    rig.start()
    here.recv()
    done, shown = LoopRecord(reference), rig_of(rate)
    took: list[tuple[float, float, float]] = []

    def part(rows: slice) -> ClosedLoop:
        return ClosedLoop.from_record(done, model(), LoopSetup(), rows)

    controller.prepare()
    with (
        tempfile.TemporaryDirectory() as folder,
        pause_garbage_collection(),
        _open_journal(Path(folder) if journal else None, part) as keep,
    ):
        for k in range(samples):
            sample: Sample
            sample, sent = here.recv()
            began = time.perf_counter()
            command = controller.command(sample)
            answered = time.perf_counter()
            here.send(command)
            controller.prepare()
            prepared = time.perf_counter()
            done.add(LoopStep(k, k * period, sample, command, answered - began), shown, controller.telemetry())
            keep(k)
            took.append((answered - began, prepared - began, prepared - sent))
    behind = here.recv()
    feedback, step, whole = 1e6 * np.array(took).T
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    print(f"{rate:g} Hz for {seconds:g} s, {os.cpu_count()} cores, load {load}; samples that the simulation sent late: {behind}")
    for name, values in (("sample to command", feedback), ("with preparation", step), ("from when the sample was sent", whole)):
        median, most, worst = np.median(values), np.quantile(values, 0.99), values.max()
        print(f"{name}: median {median:.0f} us, 99 % {most:.0f} us, worst {worst:.0f} us")
    print(f"missed deadlines: {int((whole > 1e6 * period).sum())} of {samples}")


if __name__ == "__main__":
    main(float(sys.argv[1]), float(sys.argv[2]), "alone" not in sys.argv)
