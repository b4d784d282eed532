"""Tests of tepm_opt."""

import os
import sys

# tests start many programs, which otherwise compile NumPy and SciPy each where an environment forbids to keep what was compiled
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
