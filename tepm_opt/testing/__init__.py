"""Contracts that every tracker and rig keeps, built in or plugged in: subclass one in a test file, and pytest runs it."""

from tepm_opt.testing.rigs import RigContract
from tepm_opt.testing.trackers import StandIn, TrackerContract, motion_of_arm

__all__ = ["RigContract", "StandIn", "TrackerContract", "motion_of_arm"]
