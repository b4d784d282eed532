"""Helpers that know no robot: least squares, matrices, work on several cores, short texts."""
