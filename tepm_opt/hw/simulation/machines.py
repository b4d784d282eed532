"""Choice of the engine that moves a rig: the compiled one where it can, MuJoCo where it is asked for or has to."""

from __future__ import annotations

from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.compiled_machine import CompiledMachine, Unknown
from tepm_opt.hw.simulation.engine import library
from tepm_opt.hw.simulation.machine import Machine
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.models.backends.store import warn_once
from tepm_opt.models.layout import Layout


def machine_of(file: RigFile) -> Machine:
    """The machine of a rig file.

    Raises:
        InputError: the compiled engine is asked for and cannot be had.
    """
    engine = file.simulation.engine
    if engine != "mujoco":
        built = library(Layout.from_robot(file.nominal))
        try:
            if built is not None:
                return CompiledMachine(file, built)
            missing = "there is no working C compiler"
        except Unknown as error:
            missing = str(error)
            warn_once(f"the rig runs on MuJoCo, some 70 times slower: {missing}")
        if engine == "compiled":
            raise InputError(f"simulation.engine = 'compiled': {missing}; valid: auto, mujoco")
    from tepm_opt.hw.simulation.mujoco_machine import MujocoMachine

    return MujocoMachine(file)
