"""Fault detection while a loop runs: sensors that lie, markers that slip, machines that change."""
