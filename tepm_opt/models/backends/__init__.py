"""Backends: the loops around the generated kernels, in C and as Python twins."""
