"""Result of a closed loop: errors, split of the actuation, effort, times; as arrays, a log and a summary."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.control.controller import ControllerKind, ControllerSettings, Option, Telemetry
from tepm_opt.control.controllers import DEFAULT, find_controller, settings_of
from tepm_opt.control.diagnostics.monitor import Changed
from tepm_opt.control.loop import DONE, LoopRecord
from tepm_opt.data.files import output_folder
from tepm_opt.data.frames import Tabular
from tepm_opt.data.setpoints import FORCE_COLUMNS
from tepm_opt.data.tables import write_columns
from tepm_opt.jobs.clearance import clearance, contour, contour_columns, find_contacts, moved_most, true_distance
from tepm_opt.jobs.output import save_summary
from tepm_opt.jobs.refit import changes_told, save_changed
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices
from tepm_opt.models.model import Model
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.recording.measure import GOOD, STATUS
from tepm_opt.renamed import RenamedMethod

LOG, JOB = "log.csv", "mpc"
BANDS = ((0.0, 0.5), (0.5, 2.0), (2.0, 10.0), (10.0, 50.0))  # Hz
PACKAGES = ("tepm-opt", "numpy", "scipy", "casadi", "daqp", "mujoco")


@dataclass(frozen=True)
class LoopSetup:
    """Controller and rig of a closed loop.

    Attributes:
        controller: name of a kind of controller, see `tepm_opt.control.controllers`.
        rig: as a person names it.
        seed: of the noise on a simulated rig.
        settings: of the controller; its default ones where absent.
    """

    controller: str = DEFAULT
    rig: str = "sim"
    seed: int = 0
    settings: ControllerSettings | None = None

    @property
    def kind(self) -> ControllerKind:
        """Kind of the controller.

        Raises:
            InputError: no such controller.
        """
        return find_controller(self.controller)

    @property
    def chosen(self) -> ControllerSettings:
        """Settings of the controller.

        Raises:
            InputError: no such controller.
        """
        return self.kind.settings({}) if self.settings is None else self.settings

    @staticmethod
    def from_options(controller: str, rig: str, seed: int, options: Mapping[str, Option]) -> LoopSetup:
        """Build the setup from options of the command line.

        Args:
            controller: name of its kind.
            rig: as the person named it.
            seed: of the noise on a simulated rig.
            options: those of the controller that were given, by name.

        Raises:
            InputError: no such controller, an option of another one, or a value that an option does not have.
        """
        return LoopSetup(controller, rig, seed, settings_of(find_controller(controller), options))

    of = RenamedMethod("from_options")


@dataclass(frozen=True, eq=False)
class ClosedLoop(Tabular):
    """Record of a closed loop, a row a sample; NaN where unknown.

    Attributes:
        model: the controller's.
        setup: what ran.
        devices: lags that the controller knows of.
        duration: of the reference in s, and `period`, of control.
        time: since the loop was closed in s, (samples,).
        targets: of the tip, (samples, 3) in m in G.
        counted: over which samples errors count, (samples,) of bool.
        points: tracked, (samples, points, 3) in m in G.
        truth: true tip where the rig knows it, (samples, 3) in m.
        pressures, tensions, enabled: commanded, (samples, actuators) in Pa, N and bool.
        measured: pressures and tensions, (samples, 2 · actuators), where the rig measures both.
        seconds: that the controller took, (samples,).
        steps: more columns by name, (samples,) each: what the controller logs, and what the rig said.
        outcome: how it ended, and why.
        fallbacks: number of steps that went on with something older, by the reason.
        doubts: what did not make sense, by what it is about: when it was first told, in s, and the last sentence.
        moved: how far at most the path was led out of obstacles' way, in m; NaN where there are none.
        changes: of the machine that were told.
    """

    model: Model
    setup: LoopSetup
    devices: Devices
    duration: float
    period: float
    time: np.ndarray
    targets: np.ndarray
    counted: np.ndarray
    points: np.ndarray
    truth: np.ndarray
    pressures: np.ndarray
    tensions: np.ndarray
    enabled: np.ndarray
    measured: np.ndarray
    seconds: np.ndarray
    steps: Mapping[str, np.ndarray]
    outcome: Outcome = DONE
    fallbacks: Mapping[str, int] = field(default_factory=dict)
    doubts: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    moved: float = math.nan
    changes: tuple[Changed, ...] = ()

    @staticmethod
    def from_record(done: LoopRecord, model: CompiledModel, setup: LoopSetup, rows: slice = slice(None)) -> ClosedLoop:
        """Convert the record of a running loop, or some rows of it, into arrays.

        Args:
            done: the record; may still grow.
            model: the controller's.
            setup: what ran.
            rows: which samples.
        """
        half = model.layout.inputs // 2
        rows = slice(*rows.indices(len(done.telemetry)))  # an interruption may come between two columns
        commands, places = done.commands[rows], np.array(done.rows[rows], dtype=int)

        steps = {**_stack_telemetry(done.telemetry[rows]), **true_distance(done, rows), **contour_columns(done, rows)}
        time, doubts = np.array(done.time[rows]), _doubts(done.time[rows], done.telemetry[rows])

        def stack(values: Sequence[Any], *shape: int) -> np.ndarray:
            return np.array(values, dtype=float).reshape(-1, *shape)

        return ClosedLoop(
            model.model, setup, Devices.from_model(model), done.reference.duration, done.reference.period, stack(done.time[rows]),
            done.reference.path[places], done.reference.counted[places], stack(done.points[rows], model.layout.points, 3),
            stack(done.truth[rows], 3), stack([c.pressures for c in commands], half), stack([c.tensions for c in commands], half),
            stack([c.enabled for c in commands], half).astype(bool), stack(done.measured[rows], 2 * half), stack(done.seconds[rows]),
            steps, done.outcome, dict(done.fallbacks), doubts | find_contacts(steps, time), moved_most(done.reference),
        )  # fmt: skip

    @property
    def ok(self) -> bool:
        """Whether it came to the reference's end."""
        return self.outcome.solved

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the actuators."""
        return channels_of(self.model.robot).actuators

    def __repr__(self) -> str:
        reached = f"{self.time[-1]:.2f}" if len(self.time) else "0"
        parts = [f"{name} {1e3 * self.rms(true):.3g} mm rms" for true, name in ((True, "true"), (False, "tracked"))]
        where = f"{self.setup.kind.title} on {self.setup.rig}"
        return f"ClosedLoop({self.outcome}, {where}, {reached} of {self.duration:.2f} s, {', '.join(parts)})"

    def _repr_html_(self) -> str:
        """Table of the run's figures, for notebooks."""
        told = self.summary(timing=False)
        rows = [
            ("controller", self.setup.kind.title),
            ("rig", self.setup.rig),
            ("robot", self.model.robot.name),
            ("end", str(self.outcome)),
        ]
        rows.append(("time", f"{told['reached_s']:.2f} of {self.duration:.2f} s"))
        for kind in ("true", "tracked"):
            if error := told["errors"][kind]:
                text = f"{1e3 * error['rms_m']:.3g} mm rms, {1e3 * error['largest_m']:.3g} mm at most"
                rows.append((f"error, {kind}", text))
        rows.append(("regulator steps", f"{told['pressure_moves_per_s']:.3g} 1/s"))
        rows.append(("fallbacks", str(sum(self.fallbacks.values()))))
        cells = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>" for name, text in rows)
        return f"<table>{cells}</table>"

    def errors(self, true: bool) -> np.ndarray:
        """The tip, true or tracked, less its target, (samples, 3) in m."""
        return (self.truth if true else self.points[:, -1]) - self.targets

    def rms(self, true: bool) -> float:
        """Root mean square of the tip's distance from its target where it counts, in m; NaN where nothing is known."""
        squares = (self.errors(true)[self.counted] ** 2).sum(axis=1)
        known = squares[np.isfinite(squares)]
        return float(np.sqrt(known.mean())) if len(known) else math.nan

    @cached_property
    def acting(self) -> tuple[np.ndarray, np.ndarray]:
        """p A and the tension as they act on the muscles behind the regulators' lag and the motors' rate, (samples, actuators) in N each.

        From the commands, without the delay that both share: free of the sensors' noise, and known on every rig.
        """
        area, most = self.model.values["A"], self.devices.tension_rate * self.period
        pressure, tension = self.pressures.copy(), self.tensions.copy()
        for k in range(1, len(pressure)):
            pressure[k] = self.devices.lag(pressure[k - 1], self.pressures[k - 1], self.period)
            tension[k] = tension[k - 1] + np.clip(self.tensions[k - 1] - tension[k - 1], -most, most)
        return area * pressure, tension

    def span(self) -> slice:
        """Slice of the samples from the first to the last that counts."""
        places = np.flatnonzero(self.counted)
        return slice(int(places[0]), int(places[-1]) + 1) if len(places) else slice(0)

    def spectrum(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Frequencies in Hz; powers in N² of "pressure" (p A), "tension" and "force" (F_a), summed over the actuators, where errors count.

        A Hann window over what is left without the mean, scaled so that the sum over the frequencies is the variance.
        """
        pressure, tension = (values[self.span()] for values in self.acting)
        parts, count = {"pressure": pressure, "tension": tension, "force": pressure - tension}, len(pressure)
        if count < 4:
            return np.zeros(0), {name: np.zeros(0) for name in parts}
        window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(count) / count)
        powers = {}
        for name, values in parts.items():
            found = np.abs(np.fft.rfft(window[:, None] * (values - values.mean(axis=0)), axis=0)) ** 2
            found[1 : (count + 1) // 2] *= 2
            powers[name] = found.sum(axis=1) / (count * (window**2).sum())
        return np.fft.rfftfreq(count, self.period), powers

    def shares(self) -> list[dict[str, float | None]]:
        """Root mean square in N of p A, tension and F_a over all actuators, and the tension's share of the power, by band of frequencies.

        The share is that of the powers of p A and λ; they add up to F_a only where the one does not take back the other.
        """
        frequencies, powers = self.spectrum()
        found: list[dict[str, float | None]] = []
        for low, high in BANDS:
            inside = (frequencies >= low) & (frequencies < high)
            power = {name: float(values[inside].sum()) for name, values in powers.items()}
            both = power["pressure"] + power["tension"]
            rms = {f"{name}_rms_N": math.sqrt(value / max(len(self.names), 1)) for name, value in power.items()}
            found.append({"from_Hz": low, "to_Hz": high, **rms, "share_of_tension": power["tension"] / both if both > 0 else None})
        return found

    def columns(self) -> dict[str, np.ndarray]:
        """Columns of the log by name, (samples,) each: those of a run of a data set (commands, tracked points), then everything else."""
        channels, count = channels_of(self.model.robot), len(self.time)
        columns = {"time_s": np.round(self.time, 6)}
        columns |= dict(zip(channels.inputs, np.hstack([self.pressures, self.tensions]).T, strict=True))
        columns |= dict.fromkeys(FORCE_COLUMNS, np.zeros(count))
        columns |= dict(zip(channels.coordinates, self.points.reshape(count, -1).T, strict=True))
        for name, values in (("target", self.targets), ("true_tip", self.truth)):
            columns |= {f"{name}_{axis}_m": values[:, k] for k, axis in enumerate("xyz")}
        measured = [f"pressure_{name}_measured_Pa" for name in channels.actuators]
        measured += [f"tension_{name}_measured_N" for name in channels.actuators]
        columns |= dict(zip(measured, self.measured.T, strict=True))
        columns |= {f"enabled_{name}": self.enabled[:, k].astype(float) for k, name in enumerate(channels.actuators)}
        return columns | {"counted": self.counted.astype(float), "step_seconds": self.seconds, **self.steps}

    def summary(self, timing: bool = True) -> dict[str, Any]:
        """Numbers of the run; those that differ from run to run (durations of the computation) can be left out."""
        counted, span, actuators = int(self.counted.sum()), self.span(), range(len(self.names))
        tension, half_range = self.tensions[self.counted], self.model.robot.actuation.tension_max_N / 2
        mean = tension.mean(axis=0) if counted else np.full(len(self.names), math.nan)
        step = self.model.robot.actuation.pressure_step or 1.0
        moved = np.diff(np.round(self.pressures[span] / step), axis=0) != 0  # of the regulators
        seconds = max(len(moved), 1) * self.period
        told = {
            "controller": self.setup.controller,
            "rig": self.setup.rig,
            "robot": self.model.robot.name,
            "effects": [effect.name for effect in self.model.effects],
            "seed": self.setup.seed,
            "settings": self.setup.chosen.asked,
            "end": self.outcome.ending.value,
            "message": self.outcome.message,
            "interrupted": self.outcome.ending is Ending.INTERRUPTED,
            "samples": len(self.time),
            "duration_s": self.duration,
            "reached_s": float(self.time[-1]) if len(self.time) else 0.0,
            "counted_samples": counted,
            "counted_seconds": counted * self.period,
            "errors": {"true": self._error_numbers(True), "tracked": self._error_numbers(False)},
            "pressure_moves_per_s": float(moved.sum() / seconds),
            "motors_enabled": _number(self.enabled[self.counted].mean()) if counted else None,
            "mean_tension_N": {self.names[k]: _number(mean[k]) for k in actuators},
            "mean_tension_of_mid_range": _number(mean.mean() / half_range) if half_range else None,
            "actuation": self.shares(),
            "fallbacks": dict(self.fallbacks),
            "doubts": {about: {"from_s": since, "says": text} for about, (since, text) in self.doubts.items()},
            "changes": changes_told(self.changes),
            "contour": contour(self.steps, self.counted),
            "keep_out": clearance(self.steps, self.time, self.moved),
            "rig_complaints": int((self.steps[STATUS] != GOOD).sum()) if STATUS in self.steps else 0,
        }
        if "nis" in self.steps and np.isfinite(self.steps["nis"]).any():
            seen = np.isfinite(self.steps["nis"])
            told["estimator"] = {
                "mean_nis": float(self.steps["nis"][seen].mean()),
                "mean_degrees_of_freedom": float(self.steps["coordinates_seen"][seen].mean()),
            }
        if timing:
            told["step_seconds"] = _times(self.seconds)
            told |= {"program_seconds": _times(self.steps["program_seconds"])} if "program_seconds" in self.steps else {}
            told["versions"] = {name: found for name in PACKAGES if (found := _version(name))}
        return told

    def _error_numbers(self, true: bool) -> dict[str, Any] | None:
        error = self.errors(true)[self.counted]
        error = error[np.isfinite(error).all(axis=1)]
        if not len(error):
            return None
        each = np.sqrt((error**2).mean(axis=0))
        return {
            "rms_m": self.rms(true),
            "largest_m": float(np.linalg.norm(error, axis=1).max()),
            "rms_by_axis_m": {axis: float(each[k]) for k, axis in enumerate("xyz")},
            "mean_by_axis_m": {axis: float(error[:, k].mean()) for k, axis in enumerate("xyz")},
        }

    def save(self, folder: str | Path) -> None:
        """Write log.csv and summary.json, and what was measured since the machine changed, if it did; nothing where there is no sample.

        Raises:
            InputError: the folder cannot be written to.
        """
        if not len(self.time):
            return
        folder = output_folder(folder)
        write_columns(folder / LOG, {name: values for name, values in self.columns().items() if _tells(values)})
        save_summary(folder, JOB, self.summary())
        if self.changes:
            save_changed(self, folder)


def _stack_telemetry(telemetry: Sequence[Telemetry]) -> dict[str, np.ndarray]:
    """Columns of a controller's telemetry by name, (samples,) each."""
    names = telemetry[0].columns if telemetry else {}
    return {name: np.array([row.columns[name] for row in telemetry]) for name in names}


def _doubts(time: Sequence[float], telemetry: Sequence[Telemetry]) -> dict[str, tuple[float, str]]:
    """Collect warnings by their subject: the time of the first one in s, and the last sentence."""
    found: dict[str, tuple[float, str]] = {}
    for now, row in zip(time, telemetry, strict=False):
        for about, text in row.doubts.items():
            found[about] = (found[about][0] if about in found else now, text)
    return found


def _tells(values: np.ndarray) -> bool:
    """Whether a column has anything to say."""
    return bool((values != GOOD).any()) if values.dtype.kind == "U" else bool(np.isfinite(values).any())


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _times(seconds: np.ndarray) -> dict[str, float] | None:
    if not len(seconds):
        return None
    return {"median": float(np.median(seconds)), "percentile_99": float(np.percentile(seconds, 99)), "largest": float(seconds.max())}


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
