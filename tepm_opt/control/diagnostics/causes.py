"""Causes of a change in a machine: in words, and as directions of the regressions; which of them explains what was seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from tepm_opt.control.diagnostics.change_detection import GlrStatistics

BODY, REGULATOR, MOTOR = "body", "regulator", "motor"
FILLING, EMPTYING, ZERO, LEAK = range(4)  # columns of the regulators
GAUGE = 0  # column of the motors
TIME_CONSTANT = 0.18  # s, by which a regulator's zero is told in Pa: of filling and emptying in the mean


@dataclass(frozen=True)
class Cause:
    """One thing that may change.

    Attributes:
        about: name, unique.
        says: sentence with `{size}`, in the unit that people use, and `{more}`, "more" or "less" by its sign.
        regression: of which its columns are, and `machine`, which of those beside each other.
        columns: along which it acts with `factors`; `free`: each of them has a size of its own.
        spread: of its size before anything is seen.
        prior: its probability beside the other causes.
        one_sided: whether its size is above zero.
        scale: of the size in the sentence.
    """

    about: str
    says: str
    regression: str
    machine: int
    columns: tuple[int, ...]
    spread: float
    prior: float
    one_sided: bool = False
    scale: float = 1.0
    free: bool = False
    factors: tuple[float, ...] = ()

    def describe(self, size: float) -> str:
        """Sentence that tells the cause with a size."""
        return self.says.format(
            size=abs(self.scale * size), more="more" if size > 0 else "less", stiffer="stiffer" if size > 0 else "softer"
        )


class FaultHypothesisTest:
    """Test of the hypotheses of a fault, cause by cause, against each other.

    Args:
        causes: all of them.
        columns: how many each regression has.
    """

    def __init__(self, causes: Sequence[Cause], columns: Mapping[str, int]) -> None:
        self._causes, self._groups = causes, []
        for regression, count in columns.items():
            which = [k for k, cause in enumerate(causes) if cause.regression == regression and not cause.free]
            along = np.zeros((len(which), count))
            for row, k in zip(along, which, strict=True):
                row[list(causes[k].columns)] = causes[k].factors or 1.0
            spreads, machines = np.array([causes[k].spread for k in which]), np.array([causes[k].machine for k in which])
            sided = np.array([causes[k].one_sided for k in which])
            self._groups.append((regression, which, along, machines, spreads, sided))
        self._prior = np.log([cause.prior for cause in causes])
        self._slower = [cause.columns == (FILLING, EMPTYING) and cause.regression == REGULATOR for cause in causes]

    def evidence(self, left: Mapping[str, GlrStatistics]) -> tuple[np.ndarray, np.ndarray]:
        """Logarithm of the evidence over no change at each mark, with the prior, and sizes, (marks, causes) each.

        Sizes are integrated over their normal prior, of which half is left where it is one-sided.
        """
        marks = len(left[BODY].score)
        found, sizes = np.zeros((2, marks, len(self._causes)))
        for regression, which, fixed, machines, spreads, sided in self._groups:
            of, along = left[regression], fixed
            if of.information.shape[1] == 1:
                score, information = of.score[:, 0] @ along.T, ((along @ of.information[:, 0]) * along).sum(axis=-1)
            else:
                slower = np.array([self._slower[k] for k in which])[:, None]
                along = np.where(slower, -fixed * np.maximum(of.theta[machines], 0.0), fixed)  # all rates fall by a part
                score = (of.score[:, machines] * along).sum(axis=-1)
                information = np.einsum("hi,shij,hj->sh", along, of.information[:, machines], along)
            scaled = 1 + spreads**2 * np.maximum(information, 0.0)
            size = spreads**2 * score / scaled
            half = np.where(sided, np.log(2.0) + log_ndtr(size * np.sqrt(scaled) / spreads), 0.0)
            found[:, which], sizes[:, which] = 0.5 * size * score - 0.5 * np.log(scaled) + half, size
        for k, cause in enumerate(self._causes):
            if cause.free:
                own = list(cause.columns)
                score, information = left[BODY].score[:, 0, own], left[BODY].information[:, 0][:, own][:, :, own]
                scaled = np.eye(len(own)) + cause.spread**2 * information
                size = np.linalg.solve(scaled, cause.spread**2 * score[..., None])[..., 0]
                found[:, k] = 0.5 * (size * score).sum(axis=1) - 0.5 * np.linalg.slogdet(scaled)[1]
                sizes[:, k] = np.linalg.norm(size, axis=1)
        return found + self._prior, sizes


def causes(actuators: Sequence[str], points: Sequence[str], body: Mapping[str, slice]) -> list[Cause]:
    """Everything that is looked for.

    Args:
        actuators, points: their names.
        body: slices of the columns of the tracked points, as `FaultRegressors.body`.
    """
    at = {name: part.start for name, part in body.items()}
    kind = 1 / 12  # all kinds alike, and all muscles and points within one
    each, count = kind / len(actuators), len(actuators)
    found: list[Cause] = []
    for k, name in enumerate(actuators):
        of, regulator = f"muscle {name}", f"regulator {name}"
        strength, stiffness, tension = ((at[part] + k,) for part in ("strength", "stiffness", "tension"))
        pressed = f"{regulator} gives {{size:.1f}} kPa {{more}} than it is told, or its monitor reads that much {{more}}"
        weighed = f"dynamometer {name} reads {{size:.2f}} N {{more}}, or its motor gives that much {{more}}"
        leaks = f"{regulator} leaks: {{size:.0f}} % of the absolute pressure"
        slipped, slower = f"tendon {name} has lost {{size:.0f}} % of its tension", f"{regulator} has lost {{size:.0f}} % of its speed"
        found += [
            Cause(f"strength {name}", f"{of} pulls {{size:.0f}} % {{more}}", BODY, 0, strength, 0.1, each, scale=100, factors=(-1.0,)),
            Cause(f"stiffness {name}", f"{of} is {{size:.0f}} % {{stiffer}}", BODY, 0, stiffness, 0.08, each, scale=100),
            Cause(f"tendon {name}", slipped, BODY, 0, tension, 0.3, each, True, 100),
            Cause(f"pressure monitor {name}", pressed, REGULATOR, k, (ZERO,), 5e4, each, scale=1e-3 * TIME_CONSTANT),
            Cause(f"leak {name}", leaks, REGULATOR, k, (LEAK,), 0.3, each, True, 100 * TIME_CONSTANT),
            Cause(f"lag {name}", slower, REGULATOR, k, (FILLING, EMPTYING), 0.4, each, True, 100),
            Cause(f"dynamometer {name}", weighed, MOTOR, k, (GAUGE,), 0.4, each),
        ]
    tip, tilt, friction = (at["load"],), (at["tilt"], at["tilt"] + 1), tuple(range(at["friction"], at["friction"] + count))
    found += [
        Cause("payload put on", "{size:.0f} g were put on the tip", BODY, 0, tip, 0.04, kind, True, 1e3),
        Cause("payload taken off", "{size:.0f} g were taken off the tip", BODY, 0, tip, 0.04, kind, True, 1e3, factors=(-1.0,)),
        Cause("tendon friction", "the tendons' friction has grown by {size:.2f} N each", BODY, 0, friction, 0.5, kind, True),
        Cause("base tilt", "the base has tilted by {size:.1f}°", BODY, 0, tilt, 0.015, kind, scale=180 / np.pi, free=True),
    ]
    for k, name in enumerate(points):
        own = tuple(range(at["points"] + 3 * k, at["points"] + 3 * k + 3))
        says = f"tracked point {name} has shifted by {{size:.1f}} mm"
        found.append(Cause(f"marker {name}", says, BODY, 0, own, 6e-3, kind / len(points), scale=1e3, free=True))
    forces = tuple(range(at["force"], at["force"] + count))
    says = "none of these: forces that nobody commanded, {size:.1f} N in all"
    found.append(Cause("something else", says, BODY, 0, forces, 0.3, 1e-4, free=True))
    return found
