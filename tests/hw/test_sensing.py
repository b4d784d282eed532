"""Tracker, its frame and its holders, pressure monitor and dynamometer."""

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command
from tests.hw.rigs import bar, inputs, read_until, rig_of

TILT = np.deg2rad(63.21)  # of the tip plate under 2.5 N along x, SPEC section 2


def test_noise_is_an_rms_distance():
    """SPEC section 6: 1 mm RMS in 3-D is 0.58 mm an axis, white, independent for points."""
    rig = bar(sections={"tracker": {"rate_hz": 2000, "noise_rms_m": 1e-3}})
    errors = np.array([sample.points - rig.true_points for sample in read_until(rig, 1.0)])
    assert np.sqrt((errors**2).sum(axis=2).mean()) == pytest.approx(1e-3, rel=0.05)
    assert errors.std(axis=0) == pytest.approx(np.full((2, 3), 1e-3 / np.sqrt(3)), rel=0.1)
    assert np.abs(np.corrcoef(errors.reshape(len(errors), -1).T) - np.eye(6)).max() < 0.1


def test_dropouts_last_and_are_named():
    """A point is NaN for the frames it is lost, and the status says which."""
    rig = bar(sections={"tracker": {"rate_hz": 1000, "dropout_probability": 0.02, "dropout_frames": 5}})
    samples = read_until(rig, 2.0)
    lost = np.array([np.isnan(sample.points).any(axis=1) for sample in samples])
    assert lost.mean() == pytest.approx(0.02 * 5 / (1 + 0.02 * 4), rel=0.25)
    starts = np.flatnonzero(np.diff(lost[:, 0].astype(int)) == 1) + 1
    assert all(lost[start : start + 5, 0].all() for start in starts if start + 5 < len(lost))
    for sample, gone in zip(samples, lost, strict=True):
        assert sample.status == (f"tracker lost {', '.join(np.array(['s1', 's2'])[gone])}" if gone.any() else "ok")


def test_sensor_misalignment():
    """seen = R p + shift: a quarter turn about z takes +x to +y."""
    rig = rig_of(imperfections={"sensor_misalignment": {"rotation_deg": [0, 0, 90.0], "shift_m": [0.001, 0.002, 0.003]}})
    rig.push(np.array([2.5, 0, 0]))
    seen, true = rig.read().points, rig.true_points
    shift = np.array([0.001, 0.002, 0.003])
    assert seen == pytest.approx(np.stack([-true[:, 1], true[:, 0], true[:, 2]], axis=1) + shift)


def test_sensor_offset_turns_with_its_plate():
    """An arm along the plate's normal: along z at rest, at 63.21° from it in SPEC's bent check case; other points are right."""
    rig = rig_of(imperfections={"sensor_offset": {"offset_m": {"s4": [0, 0, 0.01]}}})
    assert rig.read().points - rig.true_points == pytest.approx(np.array([[0, 0, 0]] * 3 + [[0, 0, 0.01]]), abs=1e-9)
    bent = rig_of(imperfections={"sensor_offset": {"offset_m": {"s4": [0, 0, 0.01]}}})
    bent.push(np.array([2.5, 0, 0]))
    offset = (bent.read().points - bent.true_points)[-1]
    assert np.linalg.norm(offset) == pytest.approx(0.01)
    assert offset[2] == pytest.approx(0.01 * np.cos(TILT), abs=2e-5)
    assert offset[0] == pytest.approx(0.01 * np.sin(TILT), abs=2e-5)
    with pytest.raises(InputError, match=r"point 's5'.*valid: s1, s2, s3, s4"):
        rig_of(imperfections={"sensor_offset": {"offset_m": {"s5": [0, 0, 0]}}}).read()


def test_field_distortion():
    """Towards the metal, half of `size_m` at its reach, a ninth at twice that."""
    for reach, part in ((1.0, 1 / 2), (0.5, 1 / 9)):
        rig = bar(field_distortion={"size_m": 0.006, "metal_m": [1.0, 0, 0.2], "reach_m": reach})
        assert (rig.read().points - rig.true_points)[-1] == pytest.approx([0.006 * part, 0, 0], abs=1e-9)


def test_monitor_and_dynamometer():
    """They measure what the devices do, on their grids: 4.5 kPa and 1.05 mN; with their own offsets and noise."""
    quantised = {"quantised": True}
    rig = bar(
        sections={"regulator": quantised, "stepper": quantised, "pressure_monitor": {"fitted": True}, "dynamometer": {"fitted": True}}
    )
    rig.apply(Command.from_inputs(inputs(rig, 1e5, 1.0)))
    sample = rig.read()
    assert sample.pressures == pytest.approx(np.full(3, 22 * 4500.0))
    assert sample.tensions == pytest.approx(np.full(3, 952 * 1.05e-3))
    assert rig.true_lengths - 0.2 == pytest.approx(np.full(3, (22 * 4500 * 50.27e-6 - 952 * 1.05e-3) / 358.86), rel=2e-3)
    noisy = {
        "pressure_monitor": {"fitted": True, "offset_Pa": 3000.0, "noise_rms_Pa": 500.0},
        "dynamometer": {"fitted": True, "offset_N": 0.2, "noise_rms_N": 0.01},
    }
    samples = read_until(bar(sections=noisy | {"tracker": {"rate_hz": 1000}}), 1.0)
    assert np.std([sample.pressures for sample in samples]) == pytest.approx(500, rel=0.1)
    assert np.mean([sample.pressures for sample in samples]) == pytest.approx(3000, abs=50)
    assert np.mean([sample.tensions for sample in samples]) == pytest.approx(0.2, abs=1e-3)
    plain = bar().read()
    assert plain.pressures is None
    assert plain.tensions is None
