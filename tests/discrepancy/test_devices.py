"""What gauges say of the regulators: readings made here, by a lag integrated in another way than the package's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest
from scipy.signal import lfilter

from tepm_opt.data.run import Run, RunSet
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.network import candidates
from tepm_opt.discrepancy.preparation.devices import identify_devices
from tepm_opt.discrepancy.problem.plant import Candidate, SearchablePlant
from tepm_opt.models.channels import channels_of
from tepm_opt.models.model import Model
from tests.discrepancy.small import planned

KNOWN = Model.from_robot("kang2017")
CHANNELS = channels_of(KNOWN.robot)
NOISE, GRID = 500.0, 4500.0
DELAY, FILLING, EXHAUSTING = 0.02, 0.15, 0.3


@dataclass(frozen=True)
class Uncompiled:
    """As much of a network as gauges are compared with."""

    model: Model = KNOWN
    static: bool = False
    candidates: tuple[Candidate, ...] = tuple(candidates(KNOWN))
    signals: Signals = CHANNELS.signals


def gauged(
    device: Callable[[np.ndarray], np.ndarray], delay: float = DELAY, lag: tuple[float, float] = (FILLING, EXHAUSTING),
    white: float = NOISE, rest: int = 0,
) -> RunSet:  # fmt: skip
    """Runs with readings of a device's outputs behind a lag (Euler's method at 1 ms), and rows of rest at their ends."""
    random, found = np.random.default_rng(3), []
    for asked in planned(("single_pressure.csv", "elongation.csv")):
        time, inputs = asked.setpoints.time, np.pad(asked.setpoints.inputs, ((0, rest), (0, 0)), "edge")
        time = np.concatenate([time, time[-1] + (time[1] - time[0]) * np.arange(1, rest + 1)])
        fine = np.arange(time[0], time[-1], 1e-3)
        extra = {}
        for k, name in enumerate(CHANNELS.signals.inputs):
            followed = np.interp(fine - delay, time, inputs[:, k])
            if name.endswith("_Pa"):
                goal, state = device(followed), float(device(followed[:1])[0])
                followed = np.empty_like(goal)
                for row, value in enumerate(goal):
                    state += 1e-3 / (lag[0] if value > state else lag[1]) * (value - state)
                    followed[row] = state
            noise = white if name.endswith("_Pa") else 0.01
            stem, unit = name.rsplit("_", 1)
            extra[f"{stem}_measured_{unit}"] = np.interp(time, fine, followed) + noise * random.normal(size=len(time))
        run = Run(asked.file, "fit", time, inputs, np.zeros((len(time), 3)), np.zeros((len(time), 4, 3)), extra)
        found.append(run)
    return RunSet.from_runs("gauged", found)


def seen(data: RunSet) -> Any:
    return identify_devices(data, cast("SearchablePlant", Uncompiled()))


def on_grid(values: np.ndarray) -> np.ndarray:
    return GRID * np.round(values / GRID)


@pytest.mark.slow
def test_grid_lag_and_delay() -> None:
    data = gauged(on_grid)
    found = seen(data)
    assert found.values["regulator_lag.filling_time"] == pytest.approx(FILLING, rel=0.02)
    assert found.values["regulator_lag.exhausting_time"] == pytest.approx(EXHAUSTING, rel=0.02)
    assert found.values["time_delay.delay"] == pytest.approx(DELAY, abs=1e-3)
    assert found.delay.ranges == {"time_delay.delay": (0.0, pytest.approx(DELAY, abs=2e-3))}
    assert "4500 Pa" in found.note
    lag, late = found.gauge_effects
    assert late is found.delay
    assert set(found.values) == {*lag.parameters, *late.parameters}
    for name, (low, high) in lag.ranges.items():
        assert low < found.values[name] < high < low + 0.1
    assert {c for c in found.narrow_candidates(Uncompiled().candidates) if c.ranges} >= {lag, late}


@pytest.mark.slow
def test_without_a_delay_none_is_there() -> None:
    found = seen(gauged(on_grid, delay=0.0))
    assert len(found.gauge_effects) == 1
    assert found.delay.ranges == {"time_delay.delay": (0.0, pytest.approx(1e-3, abs=1e-3))}


@pytest.mark.slow
def test_what_follows_slowly_gets_as_much_as_from_stairs() -> None:
    """Stairs behind a lag against the rows that stand for them, linear between, behind the same; rounded rows are twice as far off."""
    data = gauged(on_grid)
    for run, before in zip(seen(data).runs, data.runs, strict=True):
        assert (run.inputs[:, 6:] == before.inputs[:, 6:]).all()
        fine = np.arange(run.time[0], run.time[-1], 1e-3)

        def behind(values: np.ndarray) -> np.ndarray:
            return lfilter([0.01], [1, -0.99], values - values[0])  # 0.1 s

        for k in range(6):
            stairs = behind(on_grid(np.interp(fine, run.time, before.inputs[:, k])))
            found, rounded = (behind(np.interp(fine, run.time, rows)) for rows in (run.inputs[:, k], on_grid(before.inputs[:, k])))
            assert np.std(found - stairs) < np.std(rounded - stairs) / 2


@pytest.mark.slow
def test_without_a_grid_commands_stay_as_they_are() -> None:
    data = gauged(lambda values: values)
    found = seen(data)
    assert found.runs is data.runs
    assert found.values["regulator_lag.filling_time"] == pytest.approx(FILLING, rel=0.02)


@pytest.mark.slow
def test_a_gauge_with_a_gain_and_an_offset_of_its_own_shows_the_same_lag() -> None:
    data = gauged(on_grid)
    columns = {name: 1.02 * v + 3e3 if name.endswith("_Pa") else v for name, v in data.runs[0].extra.items()}
    found = seen(data.with_runs([replace(data.runs[0], extra=columns), data.runs[1]]))
    assert found is None or found.values["regulator_lag.filling_time"] == pytest.approx(FILLING, rel=0.03)


@pytest.mark.slow
def test_gauges_without_noise_show_it_too() -> None:
    """Mostly at rest, their readings do not differ from row to row, and what any program leaves is more than that."""
    found = seen(gauged(lambda values: values, white=0.0, rest=2000))
    assert found.values["regulator_lag.filling_time"] == pytest.approx(FILLING, rel=0.02)


@pytest.mark.slow
def test_nothing_is_said_where_gauges_show_something_else_besides() -> None:
    """No gauges; no lag; pressure that stops at half of what is asked."""
    data = gauged(on_grid)
    assert seen(data.with_runs([replace(run, extra={}) for run in data.runs])) is None
    assert seen(gauged(lambda values: values, delay=0.0, lag=(1e-3, 1e-3))) is None
    assert seen(gauged(lambda values: np.minimum(values, 6e4))) is None
