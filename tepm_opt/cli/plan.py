"""`tepm plan`: the fastest or gentlest motion from rest to rest, as set points for the rigs and a reference for controllers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt import plots
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, load, refuse_far, report, vector, warn
from tepm_opt.cli.groups import PathOptions
from tepm_opt.cli.progress import show_progress
from tepm_opt.data.files import output_folder
from tepm_opt.data.sizes import refuse_millimetres
from tepm_opt.errors import InputError
from tepm_opt.solvers.planning.objective import Objective
from tepm_opt.solvers.planning.trajectories import SHAPES, Trajectory

if TYPE_CHECKING:
    from tepm_opt.jobs.plan import PlanRun
    from tepm_opt.models.compile import CompiledModel
    from tepm_opt.solvers.planning.program import Obstacle

OBSTACLES = "sphere:x,y,z,radius or box:x0,y0,z0,x1,y1,z1"
Ends = tuple[list[float], list[float]]
NO_OPTIONS = PathOptions()


def obstacle(text: str) -> Obstacle:
    """An obstacle of --obstacle.

    Raises:
        InputError: unknown kind, wrong numbers, a ball or box without a size.
    """
    from tepm_opt.solvers.planning.program import Box, Sphere

    kind, _, numbers = text.partition(":")
    if kind not in ("sphere", "box"):
        raise InputError(f"--obstacle {text!r}: unknown kind {kind!r}; valid: {OBSTACLES}, in m")
    values = vector(numbers, f"--obstacle {kind}", 4 if kind == "sphere" else 6) or []
    first, second = (values[0], values[1], values[2]), values[3:]
    refuse_millimetres(first, f"--obstacle {text!r}")
    if kind == "sphere":
        if not 0 < second[0] <= 10:
            raise InputError(f"--obstacle {text!r}: radius {second[0]:g} m; valid: more than 0 … 10 m")
        return Sphere(first, second[0])
    if not all(a < b for a, b in zip(first, second, strict=True)):
        raise InputError(f"--obstacle {text!r}: valid: corners with x0 < x1, y0 < y1 and z0 < z1")
    return Box(first, (second[0], second[1], second[2]))


def lines(run: PlanRun, out: Path) -> list[str]:
    """Summarize a planned motion in lines for the terminal."""
    if not run.ok:
        return [f"[yellow]no plan: {escape(run.outcome.message)}[/]"]
    told = run.summary()
    low, high = told["tensions_N"]
    return [
        f"[bold]{told['duration_s']:.3f} s[/] from rest to rest, {1e3 * told['path_length_m']:.1f} mm of the tip at up to "
        f"{told['largest_speed_m_per_s']:.2f} m/s, files in {escape(str(out))}",
        f"pressures up to {1e-3 * told['largest_pressure_Pa']:.0f} kPa, tensions {low:.2f} … {high:.2f} N at up to "
        f"{told['largest_tension_rate_N_per_s']:.1f} N/s, smallest stiffness {told['smallest_stiffness_eigenvalue_N_per_m']:.3f} N/m",
        f"left on the rig: sway of {1e3 * told['left_on_rig_m']['sway']:.1f} mm where frequencies are off by the doubt, and up to "
        f"{1e3 * told['left_on_rig_m']['friction']:.0f} mm that friction holds and a controller takes away",
        f"in the full network the tip then stays within {1e3 * told['left_over_m']:.2f} mm of its rest "
        f"({told['iterations']} quadratic programs in {told['seconds']:.2f} s)",
    ]


def plan(
    start: Annotated[str | None, typer.Option("--from", help="Tip at the start, x,y,z in m in frame G.")] = None,
    end: Annotated[str | None, typer.Option("--to", help="Tip at the end, x,y,z in m.")] = None,
    path: Annotated[str | None, typer.Option("--path", metavar="PATH", help=f"Path to keep to: {', '.join(SHAPES)} or a CSV file.")] = None,
    objective: Annotated[Objective, typer.Option("--objective", help="Fastest, or of least effort in --duration.")] = Objective.TIME,
    duration: Annotated[float | None, typer.Option("--duration", metavar="S", help="Duration of the least effort in s.")] = None,
    obstacles: Annotated[
        list[str] | None, typer.Option("--obstacle", help=f"For all reference points, in m: {OBSTACLES}; may be given again.")
    ] = None,
    keep_out: Annotated[
        Path | None, typer.Option("--keep-out", metavar="FILE", help="Obstacles as tepm mpc has them: spheres, boxes, a table (TOML).")
    ] = None,
    margin: Annotated[float | None, typer.Option("--margin", metavar="N/M", help="Smallest stiffness eigenvalue on the way.")] = None,
    mid_tension: Annotated[float | None, typer.Option("--mid-tension", metavar="N", help="Tension at rest at both ends.")] = None,
    doubt: Annotated[
        float, typer.Option("--frequency-doubt", metavar="PART", help="Part by which the sway's frequencies may be off.")
    ] = 0.05,
    max_sway: Annotated[
        float | None, typer.Option("--max-sway", metavar="M", help="Sway that this doubt may leave without a controller; takes a second.")
    ] = None,
    friction: Annotated[
        float, typer.Option("--friction-doubt", metavar="PART", help="Part of the tension that friction may take beyond the model's.")
    ] = 0.25,
    loop: Annotated[bool, typer.Option("--loop", help="Leave a controller room: for references of tepm mpc.")] = False,
    which: PathOptions = NO_OPTIONS,
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("plan"),
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Plan a motion from rest to rest under all limits: set points to play, the tip's reference, figure."""
    from tepm_opt.control.collision.model import CollisionModel
    from tepm_opt.jobs.plan import tell_rest_inside
    from tepm_opt.solvers.planning.plan import FASTEST, FOR_LOOPS

    ends = vector(start, "--from"), vector(end, "--to")
    known = None if keep_out is None else tepm.read_obstacles(keep_out)
    kept = {text: obstacle(text) for text in obstacles or ()}
    kept |= {} if known is None else dict(zip(known.names, known.for_planning(), strict=True))
    settings = tepm.PlanSettings(
        min_stiffness=margin, mid_tension=mid_tension, frequency_uncertainty=doubt, max_sway=max_sway, friction_doubt=friction,
        effort_weight=FOR_LOOPS if loop else FASTEST,
    )  # fmt: skip
    _way(path, which, *ends)  # a wrong one is told before anything is compiled
    folder = output_folder(out)
    compiled = load(robot, model)
    way = _way(path, which, *ends, compiled)
    inside = CollisionModel(compiled, known).at_rest() if known is not None else ""
    if inside := inside or tell_rest_inside(compiled, {text: kept[text] for text in obstacles or ()}):
        warn(inside)
    with show_progress(as_json) as progress:
        run = tepm.run_plan(compiled, way, objective, duration, tuple(kept.values()), settings, progress)
    run.save(folder)
    plots.draw(run, folder)
    return report(run.summary(), lines(run, out), as_json, run.ok)


def _way(
    path: str | None, which: PathOptions, start: list[float] | None, end: list[float] | None, model: CompiledModel | None = None
) -> Trajectory | Ends:
    """The path to keep to, or start and end.

    Args:
        path: its name or file.
        which: its shape.
        start, end: of the tip.
        model: in whose robot's size a shape is; the paper's where absent.

    Raises:
        InputError: neither is given, or an option that does not fit the path.
    """
    if path is not None:
        return which.with_ends(start, end).trajectory(path, model)
    if start is None or end is None:
        raise InputError("a plan needs --from and --to, or --path")
    if which.given:
        raise InputError(f"--{next(iter(which.given))} belongs to a path; name one with --path")
    for name, place in (("--from", start), ("--to", end)):
        given = f"{name} {','.join(f'{value:g}' for value in place)}"
        refuse_millimetres(place, given)
        if model is not None:
            refuse_far(model, np.array(place), given)
    return start, end
