"""`tepm plan`: the fastest or gentlest motion from rest to rest, as set points for the rigs and a reference for controllers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from tepm_opt import plots
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, load, report, stderr, vector
from tepm_opt.cli.ik import trajectory
from tepm_opt.data.files import output_folder
from tepm_opt.errors import InputError
from tepm_opt.jobs.runs import save_summary
from tepm_opt.plots.plan import plan_figure
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.planning.plan import Box, MotionPlan, Objective, Obstacle, PlanSettings, Sphere, plan_move, plan_path

FIGURE = "plan.png"
OBSTACLES = "sphere:x,y,z,radius or box:x0,y0,z0,x1,y1,z1"


def obstacle(text: str) -> Obstacle:
    """An obstacle of --obstacle.

    Raises:
        InputError: unknown kind, wrong numbers, a ball or box without a size.
    """
    kind, _, numbers = text.partition(":")
    if kind not in ("sphere", "box"):
        raise InputError(f"--obstacle {text!r}: unknown kind {kind!r}; valid: {OBSTACLES}, in m")
    values = vector(numbers, f"--obstacle {kind}", 4 if kind == "sphere" else 6) or []
    first, second = (values[0], values[1], values[2]), values[3:]
    if kind == "sphere":
        if not 0 < second[0] <= 10:
            raise InputError(f"--obstacle {text!r}: radius {second[0]:g} m; valid: more than 0 … 10 m")
        return Sphere(first, second[0])
    if not all(a < b for a, b in zip(first, second, strict=True)):
        raise InputError(f"--obstacle {text!r}: valid: corners with x0 < x1, y0 < y1 and z0 < z1")
    return Box(first, (second[0], second[1], second[2]))


@contextmanager
def stages(quiet: bool) -> Iterator[Progress]:
    """A line on the error stream that says what is being done."""
    if quiet or not stderr.is_terminal:
        yield silent
        return
    with stderr.status("planning") as status:
        yield lambda stage, done, of: status.update(f"planning: {stage}")


def lines(plan: MotionPlan, out: Path) -> list[str]:
    """What a plan says to people."""
    if not plan.solved:
        return [f"[yellow]no plan: {escape(plan.outcome.message)}[/]"]
    told = plan.summary()
    low, high = told["tensions_N"]
    return [
        f"[bold]{told['duration_s']:.3f} s[/] from rest to rest, {1e3 * told['path_length_m']:.1f} mm of the tip at up to "
        f"{told['largest_speed_m_per_s']:.2f} m/s, files in {escape(str(out))}",
        f"pressures up to {1e-3 * told['largest_pressure_Pa']:.0f} kPa, tensions {low:.2f} … {high:.2f} N at up to "
        f"{told['largest_tension_rate_N_per_s']:.1f} N/s, smallest stiffness {told['smallest_stiffness_eigenvalue_N_per_m']:.3f} N/m",
        f"in the full network the tip then stays within {1e3 * told['left_over_m']:.2f} mm of its rest "
        f"(IPOPT: {told['iterations']} iterations in {told['seconds']:.1f} s)",
    ]


def plan(
    start: Annotated[str | None, typer.Option("--from", help="Tip at the start, x,y,z in m in frame G.")] = None,
    end: Annotated[str | None, typer.Option("--to", help="Tip at the end, x,y,z in m.")] = None,
    path: Annotated[
        str | None, typer.Option("--path", metavar="PATH", help="Path to keep to: circle, lissajous, line (--from, --to) or a CSV file.")
    ] = None,
    objective: Annotated[Objective, typer.Option("--objective", help="Fastest, or of least effort in --duration.")] = Objective.TIME,
    duration: Annotated[float | None, typer.Option("--duration", metavar="S", help="Duration of the least effort in s.")] = None,
    obstacles: Annotated[
        list[str] | None, typer.Option("--obstacle", help=f"For all reference points, in m: {OBSTACLES}; may be given again.")
    ] = None,
    margin: Annotated[float | None, typer.Option("--margin", metavar="N/M", help="Smallest stiffness eigenvalue on the way.")] = None,
    mid_tension: Annotated[float | None, typer.Option("--mid-tension", metavar="N", help="Tension at rest at both ends.")] = None,
    doubt: Annotated[
        float, typer.Option("--frequency-doubt", metavar="PART", help="Leave no sway even if frequencies are off by this part.")
    ] = 0.0,
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("plan"),
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Plan a motion from rest to rest under all limits: set points to play, the tip's reference, figure."""
    first, last = vector(start, "--from"), vector(end, "--to")
    kept = [obstacle(text) for text in obstacles or ()]
    settings = PlanSettings(min_stiffness=margin, mid_tension=mid_tension, frequency_uncertainty=doubt)
    targets = None if path is None else trajectory(path, None, None, None, None, start, end)
    if targets is None and (first is None or last is None):
        raise InputError("a plan needs --from and --to, or --path")
    folder = output_folder(out)
    compiled = load(robot, model)
    with stages(as_json) as progress:
        if targets is not None:
            found = plan_path(compiled, targets, objective, duration, kept, settings, progress)
        else:
            found = plan_move(compiled, first or (), last or (), objective, duration, kept, settings, progress)
    found.save(folder)
    save_summary(folder, "plan", found.summary())
    (folder / FIGURE).unlink(missing_ok=True)
    if found.solved:
        plots.save(plan_figure(found, kept), folder / FIGURE)
    return report(found.summary(), lines(found, out), as_json, found.solved)
