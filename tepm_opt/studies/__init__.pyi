"""Names of the studies and where each is at home; imported when they are first used."""

from .blind.figures import draw_blind_trials as draw_blind_trials
from .blind.page import write_blind_page as write_blind_page
from .blind.run import BlindRun as BlindRun
from .blind.run import run_blind as run_blind
from .blind.trial import TrialSeries as TrialSeries
from .machines.figures import draw_machines as draw_machines
from .machines.run import DriveTask as DriveTask
from .machines.run import Family as Family
from .machines.run import MachinesRun as MachinesRun
from .machines.run import run_machines as run_machines
from .paper.figures import draw_experiments as draw_experiments
from .paper.page import write_paper_page as write_paper_page
from .paper.run import Study as Study
from .paper.run import run_study as run_study
