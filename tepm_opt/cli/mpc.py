"""`tepm mpc`: a closed loop on any rig."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt import plots
from tepm_opt.cli import INTERRUPTED
from tepm_opt.cli.common import UNSOLVED, JsonOption, ModelOption, RobotOption, folder_for, load, open_page, report, stderr, warn
from tepm_opt.cli.driving import DriveOptions
from tepm_opt.cli.groups import TRAJECTORY_HELP, IkOptions, OptionGroup, TrajectoryOptions, WorkerOptions
from tepm_opt.cli.progress import show_progress
from tepm_opt.cli.rigs import (
    FoxgloveOption,
    RigOption,
    RosOption,
    SeedOption,
    opener,
    publisher,
    report_failure,
    robot_there,
    stopped_by_signals,
)

if TYPE_CHECKING:
    import numpy as np

    from tepm_opt.hw.rig import Command, Rig, Sample
    from tepm_opt.hw.ros.publishing import RunPublisher
    from tepm_opt.jobs.closed_loop import ClosedLoop
    from tepm_opt.jobs.mpc import Observer
    from tepm_opt.jobs.rounds import RoundsRun
    from tepm_opt.progress import Progress


@contextmanager
def live(wanted: bool, rig: Rig, ros: RunPublisher | None = None) -> Iterator[Observer | None]:
    """The live view in the browser, where it is wanted, and targets and doubts published to ROS.

    Raises:
        InputError: viser is not installed.
    """

    def publish(sample: Sample, command: Command, target: np.ndarray) -> None:
        if ros is not None:
            ros.aim(target, sample.faults)

    if not wanted:
        yield publish if ros is not None else None
        return
    from tepm_opt.studio.live import LiveView

    with LiveView(rig.robot, rig.simulated is not None) as view:
        if open_page(view.address):
            with stderr.status("waiting for the browser"):
                view.wait_for_somebody()

        def observer(sample: Sample, command: Command, target: np.ndarray) -> None:
            publish(sample, command, target)
            view.show(sample, command, target, nodes=None if rig.simulated is None else rig.simulated.true_nodes)

        yield observer


def error_line(told: dict[str, Any]) -> str:
    """The tip's errors in one line."""
    parts = []
    for kind, name in (("true", "true tip"), ("tracked", "tracked")):
        if found := told["errors"][kind]:
            parts.append(f"{name} [bold]{1e3 * found['rms_m']:.3g} mm[/] rms, {1e3 * found['largest_m']:.3g} mm at most")
    return "error: " + "; ".join(parts) if parts else "error: nothing that counts was tracked"


def clearance_lines(told: dict[str, Any]) -> list[str]:
    """Summarize the arm's distance to obstacles, and the path's displacement round them, in lines for the terminal."""
    parts = []
    if found := told["true"]:
        parts.append(f"in truth [bold]{1e3 * found['smallest_m']:.3g} mm[/]")
    if found := told["estimated"]:
        where = f"{escape(found['point'])} to {escape(found['obstacle'])} at {found['at_s']:.1f} s"
        parts.append(f"as estimated {1e3 * found['smallest_m']:.3g} mm ({where})")
    lines = [f"smallest distance to obstacles: {', '.join(parts)}"] if parts else []
    if (moved := told["path_moved_by_m"]) > 1e-4:
        lines.append(f"[yellow]the path was led round obstacles: its targets are moved by up to {1e3 * moved:.3g} mm[/]")
    return lines


def lines(loop: ClosedLoop, out: Path) -> list[str]:
    """Summarize a closed loop in lines for the terminal."""
    from tepm_opt.jobs.refit import CHANGED, refit_command

    told = loop.summary()
    where = f"files in {escape(str(out))}" if told["samples"] else "nothing to keep"
    text = [f"[bold]{told['controller']}[/]: {told['reached_s']:.2f} of {told['duration_s']:.2f} s, {told['samples']} samples, {where}"]
    if told["samples"]:
        text.append(error_line(told))
    if told["contour"]:
        found = told["contour"]["true"] or told["contour"]["tracked"]
        off = f"distance from the path {1e3 * found['rms_m']:.3g} mm rms, {1e3 * found['largest_m']:.3g} mm at most; " if found else ""
        text.append(f"{off}what counts took [bold]{told['counted_seconds']:.2f} s[/]")
    if told["keep_out"]:
        text += clearance_lines(told["keep_out"])
    if told["counted_samples"]:
        shares = [f"{100 * band['share_of_tension']:.0f} %" for band in told["actuation"] if band["share_of_tension"] is not None]
        bands = ", ".join(f"{band['from_Hz']:g}–{band['to_Hz']:g}" for band in told["actuation"])
        middle = told["mean_tension_of_mid_range"] or 0.0
        text.append(
            f"pressures: {told['pressure_moves_per_s']:.3g} moves a second; tensions: {middle:.2f} of mid-range on average; "
            f"their share of the power at {bands} Hz: {', '.join(shares)}"
        )
    if times := told["step_seconds"]:
        kept = sum(told["fallbacks"].values())
        late = f"; {kept} steps went on with an older plan" if kept else ""
        text.append(f"control step: median {1e3 * times['median']:.2g} ms, 99 % within {1e3 * times['percentile_99']:.2g} ms{late}")
    text += [f"[yellow]from {doubt['from_s']:.1f} s: {escape(doubt['says'])}[/]" for doubt in told["doubts"].values()]
    if told["changes"] and (out / CHANGED).is_dir():
        text.append(f"which effect the model lacks since then: [bold]{escape(refit_command(out))}[/]")
    if told["interrupted"]:
        text.append("[yellow]interrupted: what was done is kept[/]")
    elif not loop.ok:
        text.append(f"[yellow]ended early: {escape(told['end'])}" + (f": {escape(told['message'])}" if told["message"] else "") + "[/]")
    return text


def round_lines(run: RoundsRun, out: Path) -> list[str]:
    """Summarize rounds of learning in lines for the terminal."""
    told, kind = run.summary(), "true" if run.knows_truth else "tracked"
    text = [f"[bold]{told['controller']}[/] on {told['rig']}: {len(told['rounds'])} of {told['asked']} rounds, files in {escape(str(out))}"]
    rms = [each[f"{kind}_rms_m"] for each in told["rounds"]]
    errors = " → ".join("nothing that counts" if error is None else f"{1e3 * error:.3g}" for error in rms)
    most = 1e3 * told["largest_correction_m"]
    text.append(f"error of the {kind} tip, mm rms: [bold]{errors}[/]; targets are now corrected by up to {most:.2g} mm")
    text += [f"[yellow]{escape(says)}[/]" for says in dict.fromkeys(says for loop in run.loops for _, says in loop.doubts.values())]
    ended = f"ended early: {run.outcome.ending.value}" + (f": {run.outcome.message}" if run.outcome.message else "")
    return text if run.ok else [*text, f"[yellow]{escape(ended)}[/]"]


def _drive_rounds(
    drive: Callable[[Observer | None, Progress], RoundsRun],
    view: AbstractContextManager[Observer | None],
    out: Path,
    folder: Path,
    as_json: bool,
) -> int:
    """Drive the rounds and tell what they came to; the exit status.

    Args:
        drive: the rounds, given a live view and what is told of progress.
        view: the live view.
        out: folder as the person named it, and `folder`, where it is.
        as_json: whether the summary alone is printed.
    """
    try:
        with stopped_by_signals(), view as observer, show_progress(as_json) as bars:
            rounds = drive(observer, bars)
    except (RuntimeError, OSError) as error:
        return report_failure(error, "rounds that ended are kept")
    plots.draw(rounds, folder)
    return report(rounds.summary(), round_lines(rounds, out), as_json, rounds.ok and not any(loop.doubts for loop in rounds.loops))


@dataclass(frozen=True)
class MachineOptions(OptionGroup):
    """Options of `tepm study machines` that belonged to this command until version 0.3; they go with version 0.4."""

    machines: Annotated[int | None, typer.Option("--machines", min=1, hidden=True)] = None
    noises: Annotated[int | None, typer.Option("--noises", min=1, hidden=True)] = None
    bound: Annotated[float | None, typer.Option("--bound", min=0.0, hidden=True)] = None
    jobs: Annotated[int | None, typer.Option("--jobs", min=1, hidden=True)] = None
    scheduler: Annotated[str | None, typer.Option("--scheduler", hidden=True)] = None

    @property
    def given(self) -> dict[str, Any]:
        """Options that were given, by their names."""
        return {name: value for name, value in vars(self).items() if value is not None}

    def run_study(self, path: str, **options: Any) -> int:
        """Run `tepm study machines` in the place of this command; its exit status.

        Raises:
            InputError: no number of machines is given.
        """
        from tepm_opt.cli.study.machines import machines

        if self.machines is None:
            raise tepm.InputError(f"--{' and --'.join(self.given)}: an option of tepm study machines; leave it out, or use that command")
        warn("`tepm mpc --machines` is now `tepm study machines`; the old name goes with version 0.4")
        own = {name: self.given[name] for name in ("noises", "bound") if name in self.given}
        return machines(path, workers=WorkerOptions(self.jobs, self.scheduler), count=self.machines, **own, **options)


def mpc(
    path: Annotated[str, typer.Argument(metavar="TRAJ", help=TRAJECTORY_HELP)],
    which: TrajectoryOptions,
    kinematics: IkOptions,
    drive: DriveOptions,
    older: MachineOptions,
    rig: RigOption = "sim",
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("mpc"),
    learn: Annotated[
        int | None, typer.Option("--learn", min=1, metavar="N", help="Drive it N times, each time corrected by what was missed before.")
    ] = None,
    learned: Annotated[
        Path | None, typer.Option("--learned", metavar="FILE", help="Begin with what was learned of this path: an earlier learned.csv.")
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Watch it in the browser: a page that shows and has nothing to press.")] = False,
    ros: RosOption = None,
    foxglove: FoxgloveOption = None,
    seed: SeedOption = 0,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Follow a path, or points, in closed loop on a rig: log, figures, summary.

    A real robot is brought to the start slowly and refused if it is not where the model has it. The loop stops on a limit, a blind
    tracker or a tip that is far off, and with Ctrl-C. The exit status is 1 where it ended early, or where a gauge or the tracker did
    not make sense.
    """
    from tepm_opt.jobs.closed_loop import LOG

    if older.given:
        if rig != "sim" or view or ros or foxglove is not None or learn is not None or learned is not None:
            raise tepm.InputError("--machines simulates rigs of its own; leave --rig, --view, --ros, --foxglove, --learn and --learned out")
        shared: dict[str, Any] = {"seed": seed, "robot": robot, "model": model, "as_json": as_json}
        return older.run_study(path, which=which, kinematics=kinematics, drive=drive, out=out, **shared)
    drive.check(learning=learn is not None or learned is not None)
    setup = drive.setup(rig, seed)
    which.trajectory(path)  # a wrong one is told before anything is compiled
    known = None if learned is None else tepm.read_correction(learned)
    with folder_for(out) as folder, publisher(ros, foxglove) as shows:
        compiled = load(robot_there(robot, model, rig), model)
        targets, driven = which.trajectory(path, compiled), drive.course(setup)
        opened = opener(rig, compiled.robot, seed, shows)
        device = opened(seed)
        drive.check_rest(compiled, driven, device)
        with show_progress(as_json) as bars:
            reference = tepm.whole_reference(compiled, targets, driven, kinematics.settings(), bars)
        if learn is not None or known is not None:

            def rounds(observer: Observer | None, bars: Progress) -> RoundsRun:
                task = tepm.RoundsTask(reference, setup, learn or 1, known, kinematics.settings())
                return tepm.run_rounds(compiled, task, lambda number: opened(seed + number) if number else device, folder, bars, observer)

            return _drive_rounds(rounds, live(view, device, shows), out, folder, as_json)
        try:
            with stopped_by_signals(), live(view, device, shows) as observer, show_progress(as_json) as bars:
                loop = tepm.run_closed_loop(compiled, reference, device, setup, folder, progress=bars, observer=observer)
        except (RuntimeError, OSError) as error:
            return report_failure(error, "nothing was finished")
        try:
            plots.draw(loop, folder)
        except KeyboardInterrupt:
            warn(f"interrupted: {LOG} is in {out}, figures are not")
            return INTERRUPTED
    status = report(loop.summary(), lines(loop, out), as_json, loop.ok and not loop.doubts)
    if as_json and status == UNSOLVED:
        warn("; ".join([*([] if loop.ok else [f"ended early: {loop.outcome.message}"]), *(text for _, text in loop.doubts.values())]))
    return status
