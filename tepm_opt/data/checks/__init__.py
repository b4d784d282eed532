"""Checks of a data set: units, time, sensors, starts at rest."""
