"""Baseline: an earlier recording of the same machine, whose misfit is the model's error and not news."""
