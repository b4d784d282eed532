"""The simulated rig: a robot in MuJoCo, imperfect devices, virtual time."""
