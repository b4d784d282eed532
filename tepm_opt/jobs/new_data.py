"""A data set to fill: `dataset.toml` with a comment at every key, and the header of a run's file."""

from __future__ import annotations

import os
from pathlib import Path

from tepm_opt.data.datasets import DESCRIPTION
from tepm_opt.data.documents import toml_string
from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.tables import csv_text
from tepm_opt.jobs.import_data import refuse_taken
from tepm_opt.models.channels import channels_of
from tepm_opt.models.robot import load_robot

RUN = "run1.csv"
TEMPLATE = """\
# A data set: this file and one CSV file a run. `tepm data check FOLDER` says what is wrong with it.
name = {name}
robot = {robot}               # built in, or the path of a robot file relative to this folder
sample_rate_hz = 50           # rows a second; 1/50 s between the rows of every run
# position_noise_m = 3e-4     # the tracker's noise, 1 sigma an axis in m; estimated when absent
# static = true               # rows are equilibria: neither time_s nor sample_rate_hz is needed

[[runs]]                      # one such section a run, in the order in which they were made
file = "{run}"             # its header stands there; rows are still to come
role = "fit"                  # parameters and effects are found from these …

# [[runs]]
# file = "run2.csv"
# role = "validation"         # … and judged on these, which no fit sees: have at least one
# began_s = 120               # optional: s in the session at its first row, for what changes slowly

# Columns of a run, in any order; others are kept. SI units throughout.
#   time_s                    s, even steps; half a second of steady inputs first: a run begins at rest
#   {pressures:<26}Pa (gauge), as commanded; never empty
#   {tensions:<26}N, as commanded; 0 where there are no tendons
#   tip_force_x_N, y, z       N, a known force on the tip in G; leave all three out where there is none
#   {points:<26}m, reference points in the tracker frame G (z up along the robot); empty where a sample is
#                             lost, or all along where a point is not measured (tip alone: only {tip} filled)
#   pressure_{first}_measured_Pa … optional: what gauges show
# Tables that look otherwise (units, names, several clocks) need no editing: `tepm data import`, docs/how-to/importing.md
"""


def new_dataset(folder: str | Path, robot: str = "kang2017") -> Path:
    """Write a data set to fill into a folder; its `dataset.toml`.

    Raises:
        InputError: no such robot; the folder holds a data set or cannot be written to.
    """
    channels = channels_of(load_robot(robot))
    refuse_taken(folder)
    folder = output_folder(folder)
    names, points = channels.actuators, channels.points
    text = TEMPLATE.format(
        name=toml_string(folder.resolve().name),
        robot=toml_string(os.path.relpath(robot, folder) if Path(robot).is_file() else robot),
        run=RUN,
        pressures=f"pressure_{names[0]}_Pa … {names[-1]}",
        tensions=f"tension_{names[0]}_N … {names[-1]}",
        points=f"{points[0]}_x_m … {points[-1]}_z_m",
        tip=points[-1],
        first=names[0],
    )
    write_atomically(folder / RUN, csv_text([channels.columns]))
    write_atomically(folder / DESCRIPTION, text)
    return folder / DESCRIPTION
