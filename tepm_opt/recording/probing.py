"""Single runs of a given length, drawn and varied: what the search for the most telling run chooses from."""

from __future__ import annotations

from typing import Any

import numpy as np

from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot
from tepm_opt.recording.patterns import Circle, Level, Pattern, Random, Steps, Sweep
from tepm_opt.recording.reach import Reach

FILE, LEAD, REST = "next.csv", 1.0, 1.0
SPREAD = 0.3  # of the logarithm of a level or a time that is varied
TIMES = ("rise_s", "from_hz", "to_hz", "period_s", "amplitude_Pa")


def draw_pattern(random: np.random.Generator, robot: Robot, reach: Reach, seconds: float, loads: bool = True) -> Pattern:
    """Draw a run of one of the patterns: steps or poses, a sweep, random levels, circles.

    Args:
        random: what is drawn from.
        robot: for its actuators.
        reach: levels that it bears and its sway.
        seconds: length of the run.
        loads: whether a constant known force may act on the tip.
    """
    common = float(random.uniform(0.1, 0.6)) * reach.common
    rest: Level = {"pressure_Pa": _round_level(common)}
    if loads and random.uniform() < 0.4:
        axis = str(random.choice(["x", "y", "z"]))
        rest[f"tip_force_{axis}_N"] = _round_level(float(random.choice([-1, 1])) * random.uniform(0.3, 1.0) * reach.force)
    kind = str(random.choice(["steps", "poses", "sweep", "random", "circle"], p=[0.35, 0.2, 0.2, 0.15, 0.1]))
    start: dict[str, Any] = {"file": FILE, "role": "fit", "rest": rest, "rest_s": REST}
    left = seconds - LEAD - REST
    if kind in ("steps", "poses"):
        count = max(int(left / (random.uniform(4, 7) if kind == "poses" else random.uniform(1.2, 3.5))), 2)
        if kind == "poses" and random.uniform() < 0.5:
            start["rest"] = {}  # from no pressure at all, where dead zones and leaks show
        levels = [_level(random, robot, reach, common) for _ in range(count)]
        rise = float(random.choice([0.0, 0.2, round(0.8 / reach.sway, 1)]))
        rise = min(rise, 0.4 * left / (count + 1))
        hold = round((left - rise * (count + 1)) / count, 2)
        return Steps(**start, levels=levels, rise_s=round(rise, 2), hold_s=max(hold, 0.1))
    if kind == "sweep":
        parts = int(random.integers(1, 3))
        low, high = random.uniform(0.1, 0.6) * reach.sway, random.uniform(1.0, 4.0) * reach.sway
        levels = [_amplitude(random, robot, reach, common) for _ in range(parts)]
        return Sweep(**start, amplitudes=levels, from_hz=_round_level(low), to_hz=_round_level(high), duration_s=round(left / parts, 2))
    if kind == "circle":
        period = _round_level(random.uniform(1.0, 6.0) / reach.sway)
        size = min(random.uniform(0.2, 0.6) * min(reach.alone), 0.9 * common)
        return Circle(**start, amplitude_Pa=_round_level(size), period_s=period, turns=max(round(left / period, 2), 1.0))
    return random_run(random, reach, seconds, rest)


def random_run(random: np.random.Generator, reach: Reach, seconds: float, rest: Level | None = None) -> Random:
    """A run of random levels of everything: what one would do without knowing what to look for.

    Args:
        random: gives its seed, its times and how far pressures and tensions go.
        reach: levels that the robot bears.
        seconds: length of the run.
        rest: where it begins and ends; 0.29 of the common pressure where absent.
    """
    low, pull = 0.14 * reach.common, random.uniform(0.2, 0.6) * min(reach.tension)
    high = min(0.6 * reach.common, low + random.uniform(0.6, 1.4) * min(reach.alone))
    count = max(int((seconds - LEAD - REST) / random.uniform(1.5, 3.5)), 2)
    hold = round((seconds - LEAD - REST - 0.2 * (count + 1)) / count, 2)
    return Random(
        file=FILE, role="fit", rest=rest or {"pressure_Pa": _round_level(2 * low)}, rest_s=REST, low={"pressure_Pa": _round_level(low)},
        high={"pressure_Pa": _round_level(high), "tension_N": _round_level(pull)}, count=count,
        seed=int(random.integers(2**31)), hold_s=hold,
    )  # fmt: skip


def vary_pattern(random: np.random.Generator, pattern: Pattern) -> Pattern | None:
    """Change levels, rises and frequencies of a run by about a third; None where that is no run."""
    content = {key: _perturb(random, key, value) for key, value in pattern.model_dump(exclude_unset=True).items()}
    if isinstance(pattern, Steps):
        count, before = len(pattern.levels), pattern.rise_s * (len(pattern.levels) + 1) + pattern.hold_s * len(pattern.levels)
        content["hold_s"] = round((before - content["rise_s"] * (count + 1)) / count, 2)
    if isinstance(pattern, Circle):
        content["turns"] = round(pattern.turns * pattern.period_s / content["period_s"], 2)
    try:
        return type(pattern)(**content)
    except ValueError:
        return None


def _perturb(random: np.random.Generator, key: str, value: Any) -> Any:
    """Change levels and times in a part of a pattern at random; the rest stays."""
    if isinstance(value, dict):
        return {name: _round_level(number * np.exp(SPREAD * random.normal())) for name, number in value.items()}
    if isinstance(value, list) and key in ("levels", "amplitudes"):
        return [_perturb(random, key, part) for part in value]
    if key in TIMES:
        return _round_level(value * np.exp(SPREAD * random.normal()))
    return value


def _level(random: np.random.Generator, robot: Robot, reach: Reach, common: float) -> Level:
    """One input, one module against itself, all pressures, or pressures and tensions together."""
    layout = Layout.from_robot(robot)
    module = int(random.integers(layout.modules))
    own = layout.actuator_names[module * layout.actuators : (module + 1) * layout.actuators]
    one, other = (str(name) for name in random.choice(own, 2, replace=False))
    share = float(random.uniform(0.3, 1.0))
    kind = int(random.integers(5))
    if kind == 0:
        return {f"pressure_{one}_Pa": _round_level(common + share * reach.alone[module])}
    if kind == 1:
        return {f"tension_{one}_N": _round_level(share * reach.tension[module])}
    if kind == 2:
        return {"pressure_Pa": _round_level(float(random.uniform(0.0, 1.0)) * reach.common)}
    if kind == 3:
        change = min(0.5 * share * reach.alone[module], common)
        return {f"pressure_{module + 1}_Pa": _round_level(common - change), f"pressure_{one}_Pa": _round_level(common + change)}
    return {
        f"pressure_{one}_Pa": _round_level(common + 0.6 * share * reach.alone[module]),
        f"tension_{other}_N": _round_level(0.5 * share * reach.tension[module]),
    }


def _amplitude(random: np.random.Generator, robot: Robot, reach: Reach, common: float) -> Level:
    """Pressures that swing about rest: all together, or one module to and fro."""
    share = float(random.uniform(0.1, 0.9))
    if random.uniform() < 0.3:
        return {"pressure_Pa": _round_level(share * common)}
    layout = Layout.from_robot(robot)
    module, turned = int(random.integers(layout.modules)), random.uniform(0, 2 * np.pi)
    size = min(0.3 * share * reach.alone[module], 0.9 * common)
    own = layout.actuator_names[module * layout.actuators : (module + 1) * layout.actuators]
    return {f"pressure_{name}_Pa": _round_level(size * np.cos(angle - turned)) for name, angle in zip(own, robot.angles, strict=True)}


def _round_level(value: float) -> float:
    """Round a level to two digits, which a person can read."""
    return float(f"{value:.2g}")
