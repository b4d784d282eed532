"""Try spoilings out and write which test caught each: `python -m tests.hw.spoil OUT`; `--help` lists the options."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.hw.spoil.byhand import BY_HAND
from tests.hw.spoil.runner import NOTHING, SEED, Drawing, try_out
from tests.hw.spoil.spoiling import DRAWS, source
from tests.hw.spoil.table import Row, survivors, write_tables


@dataclass(frozen=True)
class Job:
    """One spoiling to try out.

    Attributes:
        name: of a slip by hand, or the file to draw from.
        number: of the draw; None: by hand.
        of: draws from this file.
        seed: of the draw.
    """

    name: str
    number: int | None = None
    of: int = 0
    seed: int = SEED


def work(job: Job) -> Row:
    """Find a job's spoiling and try it out, in a folder that is gone afterwards."""
    with TemporaryDirectory(prefix="spoilt-") as name:
        folder, left_out = Path(name), []
        if job.number is None:
            spoiling = NOTHING if job.name == NOTHING.name else BY_HAND[job.name].find()
        else:
            drawing = Drawing(job.name, folder / "draw", job.seed)
            spoiling, left_out = drawing.draw(job.number, job.of), drawing.left_out
        return Row(spoiling, job.number is not None, try_out(spoiling, folder / "run"), left_out)


def jobs(options: argparse.Namespace) -> Iterator[Job]:
    """What the options ask for."""
    if options.draws is None:
        wanted = (name for name, slip in BY_HAND.items() if {name, Path(slip.file).name} & {*options.names} or not options.names)
        yield from map(Job, wanted)
    for file, count in DRAWS.items():
        if not options.names or Path(file).name in options.names:
            of = count if options.draws is None else options.draws
            yield from (Job(file, number, of, options.seed) for number in range(of))


def told(row: Row, place: str) -> str:
    """A line or more for people who wait."""
    change = "".join(f"\n      {line}" for line in row.spoiling.lines(source(row.spoiling.file))) * row.drawn
    caught = row.outcome.caught or "SURVIVED"
    return f"{place} {Path(row.spoiling.file).name}: {row.spoiling.name}: {caught} ({row.outcome.seconds:.0f} s){change}"


def main() -> int:
    """Try out all that is asked for and write the tables; 1 if one survived."""
    parser = argparse.ArgumentParser(prog="python -m tests.hw.spoil", description="Spoils the safety side and looks which test notices.")
    parser.add_argument("out", type=Path, metavar="OUT", help="folder for spoilings.csv and left_out.csv")
    parser.add_argument("names", nargs="*", metavar="NAME", help="slips by hand, or files by their last name (all)")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the draws ({SEED})")
    parser.add_argument("--draws", type=int, help="only draws, so many from each file")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="at the same time (as many as there are cores)")
    options = parser.parse_args()
    todo, rows, begin = [Job(NOTHING.name), *jobs(options)], {}, time.monotonic()
    with ThreadPoolExecutor(options.jobs) as pool:
        waiting = {pool.submit(work, job): job for job in todo}
        try:
            for done in as_completed(waiting):
                rows[waiting[done]] = row = done.result()
                print(told(row, f"{len(rows)}/{len(todo)}"), file=sys.stderr, flush=True)
        finally:
            pool.shutdown(cancel_futures=True)
    print(f"{(time.monotonic() - begin) / 60:.1f} minutes", file=sys.stderr)
    if rows.pop(todo.pop(0)).outcome.caught:
        parser.error("the tests fail on a copy in which nothing is wrong: what they catch proves nothing")
    write_tables([rows[job] for job in todo], options.out)
    alive = survivors(rows.values())
    print(f"{len(rows)} spoilings, {len(rows) - len(alive)} caught; survived: {'; '.join(alive) or 'none'}")
    return int(bool(alive))


if __name__ == "__main__":
    sys.exit(main())
