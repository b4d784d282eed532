"""What stands in a terminal when somebody types the name of a rig, a command, a sample: one short line."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.hw.board.status import LinkStatistics
from tepm_opt.hw.replay import ReplayRig
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.hw.service.calibrate import Counts, fit_line
from tepm_opt.hw.service.registration import Registration
from tepm_opt.hw.simulation.bench import BenchRig
from tepm_opt.hw.trackers.frames import Frame
from tepm_opt.recording.drive import Row
from tests.hw.rigs import bar

SAMPLE = Sample(1.23, np.full((4, 3), 0.1), status="tracker lost s1")
REGISTERED = Registration(*(np.full(3, value) for value in (5.0, 0.1)), np.zeros((4, 3)), *[np.zeros(3)] * 3, 6e-4, 150, 2, ())
POSES = np.full((4, 4, 4), np.nan)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (Command.from_inputs(np.repeat([1e5, 2.5], 3)), "Command([100. 100. 100.] kPa, [2.5 2.5 2.5] N, 3 of 3 motors on)"),
        (SAMPLE, "Sample(1.230 s, tip [0.1 0.1 0.1] m, tracker lost s1)"),
        (Row(0.02, np.zeros(12), np.zeros(3), SAMPLE), "Row(0.020 s, Sample(1.230 s, tip [0.1 0.1 0.1] m, tracker lost s1))"),
        (Frame(0.5, np.array([[0.0, 0, 0], [np.nan, 0, 0]]), POSES, "tracker lost s2"), "Frame(0.500 s, 1 of 2 points, tracker lost s2)"),
        (LinkStatistics(3, 2), "LinkStatistics(3 sent, 2 received, 0 damaged, 0 lost, latency unknown)"),
        (fit_line([0, 1, 2], [1.0, 3.0, 5.0]), "CalibrationFit(y = 1 + 2 x, rms "),
        (Counts(np.zeros((7, 6)), np.zeros((7, 6))), "Counts(7 samples)"),
        (REGISTERED, "Registration([0.1 0.1 0.1] m, [5. 5. 5.] deg, rms 0.6 mm, 150 samples, 2 outliers)"),
        (bar(), "SimulatedRig('test', robot 'kang2017', 0.000 s)"),
        (BenchRig("perfect"), "BenchRig('bench of perfect"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_one_short_line(value: object, text: str) -> None:
    said = repr(value)
    assert said.startswith(text)
    assert "\n" not in said
    assert len(said) < 140


def test_the_row_that_a_recording_is_at(tmp_path) -> None:
    from tests.hw.test_simulated import recording

    rig = ReplayRig(recording(tmp_path))
    rig.read()
    assert repr(rig).endswith("row 1 of 2)")
