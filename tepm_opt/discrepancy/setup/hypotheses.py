"""Hypotheses of wrong set-up: each is a transformation of the recorded runs that would mend them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals

AXES = ("x", "y", "z")
ATMOSPHERE = 101_325.0  # Pa
UNITS = {
    "Pa": {"kPa": 1e3, "mbar": 1e2, "psi": 6894.757, "bar": 1e5, "MPa": 1e6, "kgf/cm2": 98_066.5},
    "N": {"kgf": 9.80665, "lbf": 4.448222, "gf": 9.80665e-3, "mN": 1e-3, "kN": 1e3},
    "m": {"mm": 1e-3, "cm": 1e-2, "in": 0.0254},
}
"""Units that may be written in the place of the SI unit, by their size in it."""
LEAST_TURN = 20.0  # deg (SPEC section 5): a smaller turn of the frame is a misalignment of the sensor, which is physics


@dataclass(frozen=True, eq=False)
class SetupHypothesis:
    """One mistake in the set-up, and its mend.

    Attributes:
        kind: identifier of the error.
        channels: columns concerned.
        mend: entry of an import map, or sentence, that mends it.
        apply: the run as it would have been recorded without the mistake.
        changes: "inputs", "force" or "points", whichever it concerns.
        columns: numbers of the inputs concerned.
    """

    kind: str
    channels: tuple[str, ...]
    mend: str
    apply: Callable[[Run], Run]
    changes: str
    columns: tuple[int, ...] = ()

    def shrinks(self, runs: Sequence[Run]) -> bool:
        """Whether the mend makes inputs smaller by another unit, as a muscle or tendon does that lost force."""
        size = [(np.abs(self.apply(run).inputs).sum(), np.abs(run.inputs).sum()) for run in runs]
        return self.kind == "scaled_channel" and sum(mended for mended, _ in size) < sum(recorded for _, recorded in size)

    def __repr__(self) -> str:
        """Kind and channels, in a line."""
        return f"SetupHypothesis({self.kind}: {', '.join(self.channels)})"


def input_hypotheses(signals: Signals) -> Iterator[SetupHypothesis]:
    """Exchanged commands, actuators and modules, other units, reversed signs, absolute pressures."""
    kinds = _group_by_kind(signals.inputs)
    for columns in kinds.values():
        for a, b in combinations(columns, 2):
            yield _permutation("swapped_inputs", signals, {a: b, b: a})
    actuators = _actuators(signals, kinds)
    for a, b in combinations(actuators, 2):
        yield _permutation("swapped_actuators", signals, _exchange(actuators[a], actuators[b]))
    for module in dict.fromkeys(name[0] for name in actuators):
        own = [name for name in actuators if name[0] == module]
        turns = [own[k:] + own[:k] for k in range(len(own))]
        for order in (*turns, *(turn[::-1] for turn in turns)):
            moved = [k for k, name in enumerate(order) if name != own[k]]
            if len(moved) > 1:
                pairs = {c: d for k in moved for c, d in zip(actuators[own[k]], actuators[order[k]], strict=True)}
                yield _permutation("renumbered_module", signals, pairs)
    modules = {name[0]: [other for other in actuators if other[0] == name[0]] for name in actuators}
    for one, other in combinations(modules.values(), 2):
        if len(one) == len(other):
            pairs = {c: d for a, b in zip(one, other, strict=True) for c, d in _exchange(actuators[a], actuators[b]).items()}
            yield _permutation("swapped_actuators", signals, pairs)
    for columns in kinds.values():
        unit = _unit_of(signals.inputs[columns[0]])
        for some in ([columns] if len(columns) > 1 else []) + [[column] for column in columns]:
            for name, size in UNITS.get(unit, {}).items():
                yield _scale_hypothesis(signals, some, size, f'unit = "{name}"')
                yield _scale_hypothesis(signals, some, 1 / size, f"scale = {1 / size:.6g}")
            if unit == "Pa":
                yield _absolute_hypothesis(signals, some)
            if not np.isfinite([signals.limits[k] for k in some]).any():
                yield _scale_hypothesis(signals, some, -1.0, "scale = -1")


def force_hypotheses() -> Iterator[SetupHypothesis]:
    """Known tip forces of the wrong sign, or in a frame with other axes."""
    columns = tuple(f"tip_force_{axis}_N" for axis in AXES)
    for label, matrix in (("of the opposite sign", -np.eye(3)), *_axis_changes()):
        yield SetupHypothesis(
            "inverted_force", columns, f"tip_force: axes {label}",
            lambda run, matrix=matrix: replace(run, tip_force=run.tip_force @ matrix.T), "force",
        )  # fmt: skip


def _axis_changes() -> Iterator[tuple[str, np.ndarray]]:
    """The proper and improper changes of axes, without the identity and without the reversal of all."""
    for order in permutations(range(3)):
        for signs in np.ndindex(2, 2, 2):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = 1 - 2 * np.array(signs)
            if np.trace(matrix) not in (3, -3):
                yield axes_of(matrix), matrix


def axes_of(matrix: np.ndarray) -> str:
    """Rows of a signed permutation as the entry of a map has them: '["x", "-z", "y"]'."""
    names = [f"{'-' if row[k] < 0 else ''}{AXES[k]}" for row in matrix for k in [int(np.argmax(np.abs(row)))]]
    return "[" + ", ".join(f'"{name}"' for name in names) + "]"


def _group_by_kind(inputs: Sequence[str]) -> dict[str, list[int]]:
    """Numbers of the inputs by their name without digits."""
    kinds: dict[str, list[int]] = {}
    for k, name in enumerate(inputs):
        kinds.setdefault(re.sub(r"\d+", "#", name), []).append(k)
    return kinds


def _actuators(signals: Signals, kinds: Mapping[str, list[int]]) -> dict[str, tuple[int, ...]]:
    """Columns of each actuator, in every kind, by its number; none where inputs are of one kind."""
    if len(kinds) < 2:
        return {}
    found: dict[str, list[int]] = {}
    for columns in kinds.values():
        for k in columns:
            if number := re.search(r"\d\d+", signals.inputs[k]):
                found.setdefault(number[0], []).append(k)
    return {name: tuple(columns) for name, columns in found.items() if len(columns) == len(kinds)}


def _exchange(one: Sequence[int], other: Sequence[int]) -> dict[int, int]:
    return dict(zip((*one, *other), (*other, *one), strict=True))


def _permutation(kind: str, signals: Signals, sources: Mapping[int, int]) -> SetupHypothesis:
    """Columns that hold each other's values: column k gets the values of column `sources[k]`."""
    order = np.arange(len(signals.inputs))
    for k, source in sources.items():
        order[k] = source
    channels = tuple(signals.inputs[k] for k in sorted(sources))
    mend = ", ".join(f"{signals.inputs[k]} = {signals.inputs[source]}" for k, source in sorted(sources.items()))
    columns = tuple(sorted(sources))
    return SetupHypothesis(kind, channels, f"columns: {mend}", lambda run: replace(run, inputs=run.inputs[:, order]), "inputs", columns)


def _scale_hypothesis(signals: Signals, columns: Sequence[int], factor: float, mend: str) -> SetupHypothesis:
    scale = np.ones(len(signals.inputs))
    scale[list(columns)] = factor
    channels = tuple(signals.inputs[k] for k in columns)
    text = f"{', '.join(channels)}: {mend}"
    return SetupHypothesis("scaled_channel", channels, text, lambda run: replace(run, inputs=run.inputs * scale), "inputs", tuple(columns))


def _absolute_hypothesis(signals: Signals, columns: Sequence[int]) -> SetupHypothesis:
    offset = np.zeros(len(signals.inputs))
    offset[list(columns)] = ATMOSPHERE
    channels = tuple(signals.inputs[k] for k in columns)
    return SetupHypothesis(
        "absolute_pressure", channels, f"{', '.join(channels)}: offset = {-ATMOSPHERE:g} (Pa)",
        lambda run: replace(run, inputs=run.inputs - offset), "inputs", tuple(columns),
    )  # fmt: skip


def point_hypotheses(signals: Signals, runs: Sequence[Run], modelled: Sequence[np.ndarray]) -> Iterator[SetupHypothesis]:
    """Exchanged reference points; mirrored, exchanged and turned axes of the tracker, of which the best turn is found by Procrustes.

    Args:
        signals: names of the points.
        runs: measured.
        modelled: points of the nominal model, (rows, points, axes) each.
    """
    measured, expected = np.concatenate([run.points for run in runs]), np.concatenate(modelled)
    seen = np.isfinite(measured).all(axis=2)
    yield from _swapped_markers(signals, measured, expected)
    if len(signals.axes) != 3:
        yield from (_sign_hypothesis(signals, point) for point in range(len(signals.points)))
        return
    for label, matrix in _axis_changes():
        if np.linalg.det(matrix) > 0:
            kind = "rotated_frame"
        else:
            kind = "mirrored_frame" if np.count_nonzero(np.diag(matrix)) == 3 else "swapped_axes"
        yield _frame_hypothesis(kind, signals, matrix, f"frame.axes = {label}")
    left, _, right = np.linalg.svd(expected[seen].T @ measured[seen])
    turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    is_listed = np.abs(turn - np.round(turn)).max() < 0.05  # among the changes of axes above
    if angle >= LEAST_TURN and not is_listed:
        rows = "; ".join(" ".join(f"{value:.4f}" for value in row) for row in turn)
        yield _frame_hypothesis("rotated_frame", signals, turn, f"turn the frame by {angle:.0f} deg: multiply points by [{rows}]")


def _swapped_markers(signals: Signals, measured: np.ndarray, expected: np.ndarray) -> Iterator[SetupHypothesis]:
    """The assignment of measured to modelled points that leaves least (Hungarian method), where it is not the one that stands there."""
    from scipy.optimize import linear_sum_assignment

    if not np.isfinite(measured).any(axis=(0, 2)).all():  # a point that is never measured may be anywhere
        return
    squares = np.nanmean((measured[:, :, None] - expected[:, None]) ** 2, axis=(0, 3))
    _, order = linear_sum_assignment(squares.T)  # modelled point k is measured as point order[k]
    for some in {tuple(order)} | {_pair(len(order), a, b) for a, b in combinations(range(len(order)), 2)}:
        moved = [k for k in range(len(some)) if some[k] != k]
        if moved:
            channels = _point_columns(signals, moved)
            mend = ", ".join(f"{signals.points[k]} = {signals.points[some[k]]}" for k in moved)
            yield SetupHypothesis(
                "swapped_markers",
                channels,
                f"points: {mend}",
                lambda run, some=some: replace(run, points=run.points[:, list(some)]),
                "points",
            )


def _point_columns(signals: Signals, points: Sequence[int]) -> tuple[str, ...]:
    """Columns of some points; they end in their unit where those of the inputs do."""
    suffix = f"_{signals.unit}" if all(_unit_of(name) in UNITS for name in signals.inputs) else ""
    axes = len(signals.axes)
    return tuple(f"{column}{suffix}" for k in points for column in signals.columns[k * axes : (k + 1) * axes])


def _pair(count: int, a: int, b: int) -> tuple[int, ...]:
    order = list(range(count))
    order[a], order[b] = b, a
    return tuple(order)


def _frame_hypothesis(kind: str, signals: Signals, matrix: np.ndarray, mend: str) -> SetupHypothesis:
    channels = _point_columns(signals, range(len(signals.points)))
    return SetupHypothesis(kind, channels, mend, lambda run: replace(run, points=run.points @ matrix.T), "points")


def _sign_hypothesis(signals: Signals, point: int) -> SetupHypothesis:
    sign = np.ones((len(signals.points), 1))
    sign[point] = -1.0
    name = signals.points[point]
    return SetupHypothesis("mirrored_frame", (name,), f"{name}: scale = -1", lambda run: replace(run, points=run.points * sign), "points")


def _unit_of(column: str) -> str:
    return column.rpartition("_")[2]
