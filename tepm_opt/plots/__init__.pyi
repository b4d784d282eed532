"""Names of the package and where each is at home; imported when they are first used."""

from .drawing import draw as draw
from .figure import save as save
from .gain import gain_figure as gain_figure
from .ik import ik_figure as ik_figure
from .plan import plan_figure as plan_figure
from .statics import statics_figure as statics_figure
