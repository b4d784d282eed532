"""The standard recording plan of a robot: runs that excite what may hide in it, and the text of a plan file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tepm_opt.data.documents import toml_string
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot
from tepm_opt.recording.patterns import Circle, Level, Pattern, Random, Steps, Sweep
from tepm_opt.recording.reach import FIRM, LIGHT, Reach

RATE = 50.0  # Hz: most samples a second of a plan
WIDTH = 120  # characters of a line of the file
SWEEPS = 4.0  # of the sway's frequency: where sweeps end; they begin at a tenth of it


@dataclass(frozen=True)
class PlannedPattern:
    """A run of a plan, and what it is for."""

    pattern: Pattern
    purpose: str


def sample_rate(robot: Robot) -> float:
    """The tracker's rate, or the largest of its half, third, … that is no more than 50 Hz."""
    return robot.tracker.rate_Hz / max(int(np.ceil(robot.tracker.rate_Hz / RATE - 1e-9)), 1)


def standard_runs(robot: Robot, reach: Reach, share: float = 1.0) -> tuple[PlannedPattern, ...]:
    """Runs with which the effects of the library can be told apart: every input alone and all together, slow and quick, with loads.

    Times are counted in periods of the sway, so that ramps are slow and sweeps go through it; levels are parts of `Reach`.

    Args:
        robot: for its actuators.
        reach: its levels and its sway.
        share: of the levels, for a robot that does not bear all of them at once.
    """
    layout, period = Layout.from_robot(robot), 1.0 / reach.sway
    names, count = layout.actuator_names, layout.actuators
    common, alone, least = share * reach.common, share * np.array(reach.alone), share * min(reach.alone)
    tension, pull, force = share * np.array(reach.tension), share * min(reach.tension), _round_level(share * reach.force)
    modules = range(layout.modules)

    def actuator_name(module: int, actuator: int) -> str:
        return names[module * count + actuator % count]

    def times(periods: float, shortest: float = 0.1) -> float:
        return max(round(periods * period, 1), shortest)

    def level(**values: float) -> Level:
        return {name: _round_level(value) for name, value in values.items()}

    each = [(module, actuator_name(module, k)) for module in modules for k in range(count)]
    middle, swing = 0.4 * common, min(0.42 * least, 0.35 * common)
    against: list[Level] = []
    for module in modules:
        all_of, first = f"pressure_{module + 1}_Pa", f"pressure_{actuator_name(module, 0)}_Pa"
        for sign in (1, -1):
            against.append(level(**{all_of: middle - sign * swing, first: middle + sign * swing}))
    for module in modules:
        muscle, tendon = actuator_name(module, -1 if module % 2 == 0 else 0), actuator_name(module, 0 if module % 2 == 0 else -1)
        against.append(level(**{f"pressure_{muscle}_Pa": middle + 1.2 * swing, f"tension_{tendon}_N": 0.43 * pull}))
    runs: list[tuple[Pattern, str]] = [
        (
            Steps(
                file="single_pressure.csv", role="fit", rise_s=times(1.6), hold_s=times(0.4), rest_s=2.0,
                levels=_to_and_fro([level(**{f"pressure_{name}_Pa": alone[module]}) for module, name in each]),
            ),
            "every muscle alone, up and back: gains, dead zone, hysteresis, what a neighbour feels",
        ),
        (
            Steps(
                file="single_tension.csv", role="fit", rest=level(pressure_Pa=FIRM * common), rise_s=times(1.6), hold_s=times(0.4),
                levels=_to_and_fro([level(**{f"tension_{name}_N": tension[module]}) for module, name in each]),
            ),
            "every tendon alone, up and back, muscles firm: friction in guides, slack",
        ),
        (
            Steps(
                file="elongation.csv", role="fit", rise_s=times(2.0), hold_s=times(0.4), repeats=2,
                levels=[level(pressure_Pa=part * common) for part in (1.0, 0.29, 0.71)],
            ),
            "all pressures, reversals inside reversals, twice: stiffness against stretch, hysteresis",
        ),
        (
            Steps(file="long_rest.csv", role="fit", rise_s=times(0.4), hold_s=20.0, rest_s=10.0, levels=[level(pressure_Pa=0.86 * common)]),
            "long rest, stretched and back: creep, noise",
        ),
        (
            Steps(
                file="antagonists.csv", role="fit", rest=level(pressure_Pa=middle), rise_s=times(1.2), hold_s=times(0.8), levels=against,
            ),
            "bending against each other, muscle and tendon: stiffness and dry friction where the body shears",
        ),
        (
            Random(
                file="random.csv", role="fit", rest=level(pressure_Pa=0.29 * common), count=10, rise_s=0.2, hold_s=times(1.6),
                low=level(pressure_Pa=0.14 * common),
                high=level(pressure_Pa=min(0.6 * common, 0.14 * common + 1.33 * least), tension_N=0.43 * pull),
            ),
            "everything at once, quickly: lags, delays, damping",
        ),
        (
            Sweep(
                file="sweep.csv", role="fit", rest=level(pressure_Pa=0.34 * common), amplitudes=_bends(robot, 0.125 * alone),
                from_hz=_round_level(0.12 * reach.sway), to_hz=_round_level(min(SWEEPS * reach.sway, sample_rate(robot) / 4)),
                duration_s=max(15.0, times(12.0)),
            ),
            f"bending to and fro through the sway's {reach.sway:.2g} Hz, in both directions",
        ),
    ]  # fmt: skip
    runs += [
        (
            Steps(
                file=f"{name}.csv", role="fit", rest=level(pressure_Pa=LIGHT * common, **{f"tip_force_{axis}_N": sign * force}),
                rise_s=times(1.2), hold_s=times(0.8), levels=_under_load(layout, alone, common, module),
            ),
            purpose,
        )
        for name, axis, sign, module, purpose in _loads(robot, force)
    ]  # fmt: skip
    runs += [
        (
            Circle(
                file="circle.csv", role="validation", rest=level(pressure_Pa=0.49 * common), amplitude_Pa=_round_level(0.33 * least),
                period_s=times(4.8),
            ),
            "all modules bend round and round",
        ),
        (
            Random(
                file="mixed.csv", role="validation", rest=level(pressure_Pa=0.34 * common), count=8, rise_s=times(0.5),
                hold_s=times(1.6), low=level(pressure_Pa=0.34 * common),
                high=level(pressure_Pa=min(0.34 * common + 1.17 * least, common), tension_N=0.57 * pull),
            ),
            "as random.csv, but drawn anew: the file's name is part of the seed",
        ),
    ]  # fmt: skip
    return tuple(PlannedPattern(*run) for run in runs)


def wiring_runs(robot: Robot, reach: Reach, share: float = 1.0) -> tuple[PlannedPattern, ...]:
    """Runs of 5 s for each muscle and each tendon alone, which show exchanged hoses, tendons, axes and wrong units.

    Args:
        robot: for its actuators.
        reach: its levels.
        share: of the levels, for a robot that does not bear all of them.
    """
    layout = Layout.from_robot(robot)
    each = [(k // layout.actuators, name) for k, name in enumerate(layout.actuator_names)]
    muscles = [{f"pressure_{name}_Pa": _round_level(0.5 * share * reach.alone[module])} for module, name in each]
    tendons = [{f"tension_{name}_N": _round_level(share * reach.tension[module])} for module, name in each]
    rest = {"pressure_Pa": _round_level(share * FIRM * reach.common)}
    return (
        PlannedPattern(
            Steps(file="muscles.csv", role="fit", rise_s=1.5, hold_s=1.0, rest_s=1.0, levels=_to_and_fro(muscles)),
            "every muscle alone",
        ),
        PlannedPattern(
            Steps(file="tendons.csv", role="fit", rest=rest, rise_s=1.5, hold_s=1.0, rest_s=1.0, levels=_to_and_fro(tendons)),
            "every tendon alone, muscles firm",
        ),
    )


PLANS = {"standard": standard_runs, "wiring": wiring_runs}
"""Plans by their names on the command line."""


def _to_and_fro(levels: Sequence[Level]) -> list[Level]:
    """Levels with rest between them."""
    return [one for level in levels for one in (level, {})][:-1]


def _bends(robot: Robot, amplitudes: np.ndarray) -> list[Level]:
    """Pressures that bend each module, odd ones across and even ones along the first actuator's angle."""
    names, found = Layout.from_robot(robot).actuator_names, list[Level]()
    for module, amplitude in enumerate(amplitudes):
        parts = np.cos(robot.angles - robot.angles[0] - (np.pi / 2 if module % 2 == 0 else 0.0))
        own = names[module * robot.actuators : (module + 1) * robot.actuators]
        found.append(
            {f"pressure_{name}_Pa": _round_level(amplitude * part) for name, part in zip(own, parts, strict=True) if abs(part) > 1e-6}
        )
    return found


def _under_load(layout: Layout, alone: np.ndarray, common: float, module: int) -> list[Level]:
    """List the levels while a force acts on the tip: two muscles of a module, then all."""
    own = layout.actuator_names[module * layout.actuators :][:2]
    first, second = ({f"pressure_{name}_Pa": _round_level(LIGHT * common + 0.45 * alone.min())} for name in own)
    return [first, {}, second, {}, {"pressure_Pa": _round_level(0.46 * common)}]


def _loads(robot: Robot, force: float) -> list[tuple[str, str, int, int, str]]:
    """Name of the run, axis and sign of the force, module that moves, purpose; nothing pulls a guided robot sideways."""
    down = "z" if not robot.geometry.guide else "xyz"[int(np.argmax(np.abs(robot.mount.rotation[:, 2])))]
    found = [
        ("weight", down, -1, 0, f"a weight on the tip ({force:g} N: {1e3 * force / 9.81:.0f} g), which a person hangs on a real robot")
    ]
    return found if robot.geometry.guide else [*found, ("side_load", "x", 1, robot.modules - 1, "pulled sideways, over a pulley")]


def _round_level(value: float) -> float:
    """Round a level to two digits, which a person can read."""
    return float(f"{value:.2g}")


def plan_text(
    name: str, robot: str, rate: float, runs: Sequence[PlannedPattern], head: Sequence[str] = (), noise: float | None = None
) -> str:
    """The text of a plan file that `read_plan` reads.

    Args:
        name: of the data set to be recorded.
        robot: a built-in robot, or the path of a robot file as seen from the plan's folder.
        rate: of the samples in Hz.
        runs: in order.
        head: comments at the top.
        noise: of the tracker, 1 sigma per axis in m, where it is known.
    """
    lines = [*(f"# {line}" for line in head), f"name = {toml_string(name)}", f"robot = {toml_string(robot)}"]
    lines += [f"sample_rate_hz = {rate:.6g}", *([f"position_noise_m = {noise!r}"] if noise else [])]
    for run in runs:
        content = {**run.pattern.model_dump(exclude_unset=True), "pattern": run.pattern.pattern}  # type: ignore[attr-defined]
        order = ["file", "role", "pattern", *(key for key in content if key not in ("file", "role", "pattern"))]
        lines += ["", f"# {run.purpose}", "[[runs]]", *(_pair(key, content[key]) for key in order)]
    return "\n".join(lines) + "\n"


def _pair(key: str, value: Any) -> str:
    """A key with its value, lists of tables over several lines where they are long."""
    line = f"{key} = {_value(value)}"
    if len(line) <= WIDTH or not isinstance(value, list):
        return line
    rows = [""]
    for part in value:
        text = f"{_value(part)}, "
        if len(rows[-1]) + len(text) > WIDTH - 4:
            rows.append("")
        rows[-1] += text
    return "\n".join([f"{key} = [", *(f"    {row.rstrip()}" for row in rows), "]"])


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name} = {_value(one)}" for name, one in value.items()) + "}"
    if isinstance(value, str):
        return toml_string(value)
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, int) or abs(value) < 1e4:
        return f"{value:g}" if isinstance(value, float) else str(value)
    power = int(np.floor(np.log10(abs(value))))
    return f"{value / 10**power:.12g}e{power}"
