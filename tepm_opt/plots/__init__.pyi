"""Names of the package and where each is at home; see `tepm_opt.lazy`."""

from tepm_opt.plots.drawing import draw as draw
from tepm_opt.plots.figure import save as save
from tepm_opt.plots.gain import gain_figure as gain_figure
from tepm_opt.plots.ik import ik_figure as ik_figure
from tepm_opt.plots.plan import plan_figure as plan_figure
from tepm_opt.plots.statics import statics_figure as statics_figure
