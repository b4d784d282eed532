"""Data sets that are wrong or hopeless: refused with a line that says why, explained all the same, or left unexplained, never
explained by an effect that is not there."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.cli import run as tepm
from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.discrepancy.assessment.result import Verdict, VerdictStatus
from tepm_opt.errors import InputError
from tepm_opt.jobs.discrepancy import DiscrepancyOptions, run_discrepancy
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.robot import robot_text
from tests.discrepancy.small import FILES, NOISE, changed, cut, dataset_of, measured, planned, true_values

SECONDS = 4.0  # of every run
TOML, FIRST = "dataset.toml", FILES[0]
Change = Callable[[Run], dict[str, np.ndarray]]


@dataclass(frozen=True)
class Machine:
    """A healthy machine: recalibration explains all it does.

    Attributes:
        clean: its runs without noise, longer than those of the data set.
        dataset: what was measured.
    """

    clean: tuple[Run, ...]
    dataset: DataSet


@dataclass(frozen=True)
class Case:
    """Something wrong.

    Attributes:
        name: what.
        spoil: the data set with it, from the machine.
        edit: what is done to the files then.
        says: expressions that the refusal must match, in any order; None where it need not be refused.
        allowed: names or labels of effects that are no wrong answer.
        status: what a verdict must be, where that is certain.
        notes: expressions that the verdict's notes must match.
        slow: whether it takes long to see that nothing explains it.
    """

    name: str
    spoil: Callable[[Machine], DataSet] = lambda machine: machine.dataset
    edit: Callable[[Path], None] = lambda folder: None
    says: tuple[str, ...] | None = None
    allowed: tuple[str, ...] = ()
    status: VerdictStatus | None = None
    notes: tuple[str, ...] = ()
    slow: bool = False


@pytest.fixture(scope="module")
def machine(kang: CompiledModel) -> Machine:
    clean = tuple(measured(changed(kang, **true_values(kang)), planned(), noise=0.0))
    return Machine(clean, dataset_of(kang, [cut(noisy(run), SECONDS) for run in clean]))


def noisy(run: Run, noise: float = NOISE) -> Run:
    random = np.random.default_rng([len(run.file), run.rows])
    return replace(run, points=run.points + noise * random.normal(size=run.points.shape))


def every(change: Change) -> Callable[[Machine], DataSet]:
    """All runs changed."""
    return lambda machine: replace(machine.dataset, runs=tuple(replace(run, **change(run)) for run in machine.dataset.runs))


def first(change: Change) -> Callable[[Machine], DataSet]:
    """The first run changed."""

    def spoil(machine: Machine) -> DataSet:
        run, *others = machine.dataset.runs
        return replace(machine.dataset, runs=(replace(run, **change(run)), *others))

    return spoil


def points(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda run: {"points": change(run.points)}


def inputs(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda run: {"inputs": change(run.inputs)}


def scaled(pressures: float, tensions: float) -> Change:
    return inputs(lambda u: u * np.repeat([pressures, tensions], 6))


def order(*columns: int) -> Change:
    """Points in another order."""
    return points(lambda p: p[:, list(columns)])


def some(share: float, value: float) -> Change:
    """A value in the place of a part of the poses."""

    def change(run: Run) -> dict[str, np.ndarray]:
        lost = np.random.default_rng(run.rows).random(run.points.shape[:2]) < share
        return {"points": np.where(lost[:, :, None], value, run.points)}

    return change


def sensor(number: int, value: Callable[[np.ndarray], np.ndarray | float]) -> Change:
    """All samples of one point changed."""

    def change(run: Run) -> dict[str, np.ndarray]:
        changed = run.points.copy()
        changed[:, number] = value(changed[:, number])
        return {"points": changed}

    return change


def kept(*numbers: int, **roles: str) -> Callable[[Machine], DataSet]:
    """Only some runs."""
    return lambda machine: replace(machine.dataset, runs=tuple(replace(machine.dataset.runs[k], **roles) for k in numbers))


def late(*seconds: float) -> Callable[[Machine], DataSet]:
    """Positions that trail the inputs by so much in each run, or lead them."""

    def moved(run: Run, by: float) -> Run:
        at = np.clip(run.time - by, run.time[0], run.time[-1])
        flat = run.points.reshape(run.rows, -1)
        shifted = np.stack([np.interp(at, run.time, column) for column in flat.T], axis=1)
        return cut(noisy(replace(run, points=shifted.reshape(run.points.shape))), SECONDS)

    return lambda machine: replace(
        machine.dataset, runs=tuple(moved(run, by) for run, by in zip(machine.clean, np.resize(seconds, len(machine.clean)), strict=True))
    )


def resampled(
    hertz: float, jitter: float = 0.0, declared: float | None = None, seconds: float | None = None
) -> Callable[[Machine], DataSet]:
    """Sampled at another rate, each sample up to a part of the step aside."""

    def change(run: Run) -> Run:
        time = np.arange(run.time[0], seconds or run.time[-1], 1 / hertz)
        time[1:-1] += jitter / hertz * np.random.default_rng(1).uniform(-1, 1, len(time) - 2)

        def at(values: np.ndarray) -> np.ndarray:
            flat = values.reshape(run.rows, -1)
            return np.stack([np.interp(time, run.time, column) for column in flat.T], axis=1).reshape(len(time), *values.shape[1:])

        return noisy(replace(run, time=time, inputs=at(run.inputs), tip_force=at(run.tip_force), points=at(run.points)))

    return lambda machine: replace(machine.dataset, runs=tuple(change(run) for run in machine.clean), sample_rate=declared or hertz)


def at_rest(run: Run) -> dict[str, np.ndarray]:
    random = np.random.default_rng(run.rows)
    still = run.points[:20].mean(axis=0) + NOISE * random.normal(size=run.points.shape)
    return {"inputs": np.broadcast_to(run.inputs[:1], run.inputs.shape), "points": still, "tip_force": 0 * run.tip_force}


def copied(machine: Machine) -> DataSet:
    """The positions of one run in the place of another's."""
    one, other, *rest = machine.dataset.runs
    return replace(machine.dataset, runs=(one, replace(other, points=one.points), *rest))


def pasted(machine: Machine) -> DataSet:
    """The motion of one run, measured anew, in the place of another's."""
    one, other, *rest = machine.dataset.runs
    return replace(machine.dataset, runs=(one, noisy(replace(other, points=cut(machine.clean[0], SECONDS).points)), *rest))


def repeated(run: Run) -> dict[str, np.ndarray]:
    rows = np.insert(np.arange(run.rows), 60, [60, 60, 60])
    return {name: getattr(run, name)[rows] for name in ("time", "inputs", "tip_force", "points")}


def backwards(run: Run) -> dict[str, np.ndarray]:
    rows = np.r_[:50, 80:49:-1, 81 : run.rows]
    return {"time": run.time[rows]}


def text(file: str, old: str, new: str) -> Callable[[Path], None]:
    """Replace the first occurrence in a file."""

    def edit(folder: Path) -> None:
        content = (folder / file).read_text()
        assert old in content
        (folder / file).write_text(content.replace(old, new, 1))

    return edit


def field(line: int, column: int, value: str) -> Callable[[Path], None]:
    """Another text in one field of the first run."""

    def edit(folder: Path) -> None:
        rows = [row.split(",") for row in (folder / FIRST).read_text().splitlines()]
        rows[line][column] = value
        (folder / FIRST).write_text("\n".join(",".join(row) for row in rows) + "\n")

    return edit


def without_column(folder: Path) -> None:
    rows = [row.split(",") for row in (folder / FIRST).read_text().splitlines()]
    at = rows[0].index("tension_13_N")
    (folder / FIRST).write_text("\n".join(",".join(row[:at] + row[at + 1 :]) for row in rows) + "\n")


def robot(old: str, new: str) -> Callable[[Path], None]:
    """The data set names a robot file that differs in one line."""

    def edit(folder: Path) -> None:
        content = robot_text("kang2017")
        assert re.search(old, content)
        (folder / "robot.toml").write_text(re.sub(old, new, content, count=1))
        text(TOML, 'robot = "kang2017"', 'robot = "robot.toml"')(folder)

    return edit


CASES = [
    # runs
    Case("no runs", kept(), says=("role 'fit'|no runs",)),
    Case("only validation runs", kept(0, 1, role="validation"), says=("no run has the role 'fit'",)),
    Case("a single run", kept(2), notes=("kept for validation", "parts of runs"), status=VerdictStatus.NO_DISCREPANCY, slow=True),
    Case("no excitation", every(at_rest), says=("excites? anything|nothing is excited",)),
    Case("inputs stand while the robot moves", every(lambda run: {**at_rest(run), "points": run.points}), says=("excites anything",)),
    Case("one run stands", first(at_rest), slow=True),
    Case("positions of another run", copied, says=("same positions as in",)),
    Case("positions of another run measured anew", pasted, slow=True),
    # sensors
    Case(
        "a sensor without samples",
        every(sensor(1, lambda p: np.nan * p)),
        status=VerdictStatus.NO_DISCREPANCY,
        notes=("s2: not measured in any run",),
        slow=True,
    ),
    Case("no sensor has samples", every(points(lambda p: np.nan * p)), says=("no sample",)),
    Case("four in ten samples missing", every(some(0.4, np.nan)), status=VerdictStatus.NO_DISCREPANCY, slow=True),
    Case("zeros for missing samples", every(some(0.1, 0.0)), says=("all coordinates are 0",)),
    Case("a frozen sensor", first(sensor(3, lambda p: np.where(np.arange(len(p))[:, None] > 100, p[100], p))), says=("s4", "frozen")),
    Case("few spikes", every(some(0.02, 0.5)), status=VerdictStatus.NO_DISCREPANCY, notes=("Outliers: .* are left out",), slow=True),
    Case("many spikes", every(some(0.1, 0.5)), says=("spikes", "samples stray")),
    Case(
        "a sensor frozen for a moment",
        first(sensor(3, lambda p: np.where((np.arange(len(p)) // 30 == 3)[:, None], p[90], p))),
        status=VerdictStatus.NO_DISCREPANCY,
        notes=("Frozen: 29 of",),
        slow=True,
    ),
    Case(
        "noise of 0.45 mm",
        every(points(lambda p: p + 0.75**0.5 * NOISE * np.random.default_rng(1).normal(size=p.shape))),
        status=VerdictStatus.NO_DISCREPANCY,
        notes=("3[0-9] % above the 0.3 mm assumed",),
        slow=True,
    ),
    Case(
        "a table that vibrates",
        every(lambda run: {"points": run.points + 1e-3 * np.sin(14 * run.time + run.rows)[:, None, None] * [1, 0.5, 0.2]}),
        allowed=("base_vibration",),
        slow=True,
    ),
    Case("noise only", every(lambda run: {"points": at_rest(run)["points"]}), slow=True),
    Case(
        "noise of 20 mm",
        lambda m: replace(m.dataset, runs=tuple(cut(noisy(run, 20e-3), SECONDS) for run in m.clean), position_noise=20e-3),
        slow=True,
    ),
    Case(
        "noise of 20 mm undeclared", lambda m: replace(m.dataset, runs=tuple(cut(noisy(run, 20e-3), SECONDS) for run in m.clean)), slow=True
    ),
    Case("infinite position", edit=field(40, -1, "inf"), says=("s4_z_m", "inf")),
    # order and frame
    Case("s2 and s3 interchanged", every(order(0, 2, 1, 3)), status=VerdictStatus.SETUP_ERROR, slow=True),
    Case("s1 and s4 interchanged", every(order(3, 1, 2, 0)), status=VerdictStatus.SETUP_ERROR, slow=True),
    Case("s3 and s4 interchanged in one run", first(order(0, 1, 3, 2)), says=("s3 and s4 interchanged",)),
    Case("points upside down", every(order(3, 2, 1, 0)), status=VerdictStatus.SETUP_ERROR, slow=True),
    Case("y and z interchanged", every(points(lambda p: p[..., [0, 2, 1]])), status=VerdictStatus.SETUP_ERROR, slow=True),
    Case("frame shifted by 100 mm", every(points(lambda p: p + np.array([0, 0.1, 0]))), allowed=("sensor_misalignment",), slow=True),
    Case("left-handed frame", every(points(lambda p: p * [1, -1, 1])), status=VerdictStatus.SETUP_ERROR, slow=True),
    # units
    Case("positions in mm", every(points(lambda p: 1e3 * p)), says=("in mm",)),
    Case("positions in cm", every(points(lambda p: 1e2 * p)), says=("in cm",)),
    Case("positions in inches", every(points(lambda p: p / 0.0254)), says=("in inches",)),
    Case("one run in mm", first(points(lambda p: 1e3 * p)), says=(FIRST, "in mm")),
    Case("pressures in kPa", every(scaled(1e-3, 1)), says=("kPa",)),
    Case("pressures in bar", every(scaled(1e-5, 1)), says=("bar",)),
    Case("pressures in MPa", every(scaled(1e-6, 1)), says=("MPa",)),
    Case("tensions in g", every(scaled(1, 102)), says=("in g|in mN",)),
    Case("pressures above the limit", every(scaled(3, 1)), says=("pressures reach", "500000")),
    Case("negative pressures", every(inputs(lambda u: u - np.repeat([2e4, 0], 6))), says=("negative",)),
    # a threshold is the same thing as pressures counted from another zero
    # where no muscle is empty, as much more pressure in all of them is a threshold, or a rest length that is off
    Case(
        "absolute pressures",
        every(inputs(lambda u: u + np.repeat([101325.0, 0], 6))),
        allowed=("pressure_dead_zone", "parameter[L_0]"),
        slow=True,
    ),
    Case("muscles named in another order", every(inputs(lambda u: u[:, [1, 0, 2, 3, 4, 5, 7, 6, 8, 9, 10, 11]])), slow=True),
    # time
    Case("clock late by 1 s", late(1.0), notes=("shifted clock.*trail",), status=VerdictStatus.UNEXPLAINED, slow=True),
    Case("clock early by 0.3 s", late(-0.3), says=("not at rest",)),
    Case("clock early by 2 s", late(-2.0), says=("not at rest",)),
    Case("clock of one run late", late(1.0, 0.0, 0.0, 0.0), notes=(f"{FIRST}: shifted clock",), slow=True),
    Case("time in ms", every(lambda run: {"time": 1e3 * run.time}), says=("milliseconds",)),
    Case("time going back", first(backwards), says=("time goes back",)),
    Case("time standing", edit=field(30, 0, "0.56"), says=("time_s",)),
    Case("rows twice", first(repeated), says=("copy of the row before",)),
    Case("2 Hz", resampled(2.0), slow=True),
    Case("5 Hz", resampled(5.0), slow=True),
    Case("non-uniform sampling", resampled(50.0, 0.45, seconds=SECONDS), status=VerdictStatus.NO_DISCREPANCY, slow=True),
    Case("another rate than declared", resampled(25.0, declared=50.0), says=("25 Hz", "50")),
    # files
    Case("text in a number", edit=field(30, 3, "high"), says=(FIRST, "line 31", "pressure_13_Pa", "'high'")),
    Case("unknown command", edit=field(30, 3, ""), says=(FIRST, "pressure_13_Pa")),
    Case("missing column", edit=without_column, says=(FIRST, "'tension_13_N'")),
    Case("empty file", edit=lambda folder: (folder / FIRST).write_text(""), says=(FIRST, "empty")),
    Case("missing file", edit=lambda folder: (folder / FIRST).unlink(), says=(FIRST, "No such file")),
    Case("no description", edit=lambda folder: (folder / TOML).unlink(), says=(TOML,)),
    Case("description is no TOML", edit=text(TOML, "name =", "name"), says=(TOML, "TOML")),
    Case("unknown role", edit=text(TOML, '"validation"', '"test"'), says=("role", "'test'")),
    # robot
    Case("unknown robot", edit=text(TOML, '"kang2017"', '"kang2018"'), says=("'kang2018'",)),
    Case("robot of one module", edit=robot("modules = 2", "modules = 1"), says=("no actuator|other",)),
    Case("robot of other length", edit=robot(r"L_0 = 0\.200", "L_0 = 0.150"), allowed=("parameter[L_0]",), slow=True),
    Case("robot of other radius", edit=robot(r"\nr = 0\.040", "\nr = 0.030"), allowed=("parameter[r]",), slow=True),
]


def wrongly_sure(verdict: Verdict, allowed: tuple[str, ...]) -> list[str]:
    """Effects named with more than even odds that are not there."""
    if verdict.status is not VerdictStatus.NAMED:
        return []
    return [
        each.candidate.label
        for each in verdict.effects
        if each.probability >= 0.5 and {each.candidate.name, each.candidate.label}.isdisjoint(allowed)
    ]


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    "case", [pytest.param(case, id=case.name.replace(" ", "-"), marks=[pytest.mark.slow] if case.slow else []) for case in CASES]
)
def test_bad_data_are_refused_or_humbly_explained(machine: Machine, tmp_path: Path, case: Case) -> None:
    folder, out = tmp_path / "data", tmp_path / "out"
    write_dataset(case.spoil(machine), folder)
    case.edit(folder)
    if case.says is not None:
        with pytest.raises(InputError) as refusal:
            run_discrepancy(folder, out)
        message = str(refusal.value)
        assert "\n" not in message
        missing = [expression for expression in case.says if not re.search(expression, message)]
        assert not missing, message
        return
    try:
        verdict = run_discrepancy(folder, out).verdict
    except InputError:
        if case.status is not None:
            raise
        return
    assert not wrongly_sure(verdict, case.allowed), verdict.paragraph
    assert case.status in (None, verdict.status), verdict.paragraph
    missing = [expression for expression in case.notes if not re.search(expression, " ".join(verdict.notes))]
    assert not missing, verdict.notes


@pytest.mark.slow
def test_a_clock_that_leads_names_nothing(machine: Machine, tmp_path: Path) -> None:
    """What the data check would refuse, since it moves before its inputs do."""
    write_dataset(late(-0.3)(machine), tmp_path / "data")
    verdict = run_discrepancy(tmp_path / "data", tmp_path / "out", options=DiscrepancyOptions(despite_errors=True)).verdict
    assert re.match("all runs: shifted clock: positions lead the inputs by 0.[23]", verdict.notes[0])
    assert verdict.status is VerdictStatus.UNEXPLAINED
    assert verdict.next.startswith("put inputs and positions on one clock")


def test_no_case_twice() -> None:
    assert len({case.name for case in CASES}) == len(CASES) >= 30


@pytest.mark.parametrize("name", ["positions in mm", "missing column", "pressures in bar"])
def test_the_command_says_so_in_one_line(machine: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    (case,) = (case for case in CASES if case.name == name)
    folder, out = tmp_path / "data", tmp_path / "out"
    write_dataset(case.spoil(machine), folder)
    case.edit(folder)
    assert tepm(["discrepancy", str(folder), "--out", str(out), "--json"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.strip().splitlines()
    assert line.startswith("error:")
    assert all(re.search(expression, line) for expression in case.says or ()), line
