"""Experiments on any rig: plans, recording, playing set points, and data sets read with their robot. Needs rigs and data, no solvers."""
