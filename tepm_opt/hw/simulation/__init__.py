"""Simulated rigs in virtual time: `rig` is an arm in MuJoCo, `bench` one actuator in its guide.

A `rigfile` says what a rig is made of: `devices` and `imperfections`. `machine` drives the network (`mujoco_network`) through its
`actuation`, from an `equilibrium` on, along a `timeline`; `view` draws it.
"""
