"""Simulated rigs in virtual time: `rig` is an arm, `bench` one actuator in its guide.

A `rigfile` says what a rig is made of: `devices` and `imperfections`. A `machine` drives a `network` through its `actuation`, from an
`equilibrium` on, along a `timeline`, in steps within the limit of `stability`; `machines` chooses its engine: `compiled_machine` on
`engine` (mechanics.c, devices.c), or `mujoco_machine` on `mujoco_network`. `view` draws it.
"""
