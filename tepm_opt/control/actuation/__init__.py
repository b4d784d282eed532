"""Pressures and tensions: what regulators and motors do, their lags and delays, and the allocation of coarse pressures."""
