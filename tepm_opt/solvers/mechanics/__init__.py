"""Equilibrium and motion of the network, and what it predicts of measured runs."""
