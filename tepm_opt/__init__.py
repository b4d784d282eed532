"""Model-based control and trajectory optimisation of continuum robots made of pneumatic muscles with embedded tendons.

from tepm_opt import circle, compile_model, solve_gain, solve_ik, solve_statics

model = compile_model("kang2017")
found = solve_ik(model, [0.15, 0.0, 0.35])
held = solve_statics(model, found.allocation.inputs)
G = solve_gain(held).matrix
"""

from tepm_opt.data.setpoints import SetPoints, read_setpoints, write_setpoints
from tepm_opt.errors import InputError
from tepm_opt.jobs.runs import run_gain, run_ik, run_statics
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model, read_model, write_model
from tepm_opt.models.robot import Robot, load_robot
from tepm_opt.solvers.allocation import ActuationMode, allocate
from tepm_opt.solvers.gain import Gain, input_curve, solve_gain, workspace_map
from tepm_opt.solvers.kinematics import Configuration, solve_ik, solve_trajectory
from tepm_opt.solvers.linear import Linear, linearise
from tepm_opt.solvers.modes import modes, poles, rk4_step_limit, state_matrix
from tepm_opt.solvers.reduction import balanced, modal
from tepm_opt.solvers.simulate import Directions, Simulation, simulate
from tepm_opt.solvers.statics import Equilibrium, solve_statics
from tepm_opt.solvers.trajectories import Trajectory, circle, line, lissajous, read_trajectory

__all__ = [
    "ActuationMode",
    "CompiledModel",
    "Configuration",
    "Directions",
    "Equilibrium",
    "Gain",
    "InputError",
    "Linear",
    "Model",
    "Robot",
    "SetPoints",
    "Simulation",
    "Trajectory",
    "allocate",
    "balanced",
    "circle",
    "compile_model",
    "input_curve",
    "line",
    "linearise",
    "lissajous",
    "load_robot",
    "modal",
    "modes",
    "poles",
    "read_model",
    "read_setpoints",
    "read_trajectory",
    "rk4_step_limit",
    "run_gain",
    "run_ik",
    "run_statics",
    "simulate",
    "solve_gain",
    "solve_ik",
    "solve_statics",
    "solve_trajectory",
    "state_matrix",
    "workspace_map",
    "write_model",
    "write_setpoints",
]
