"""A controller on many random machines around a robot file: what it reaches where nobody tuned it."""
