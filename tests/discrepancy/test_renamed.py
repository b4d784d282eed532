"""Modules that plant files import keep their names of version 0.2 for one version."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.slow
def test_old_names_give_the_same_objects_with_a_warning() -> None:
    """In a process of its own: here the modules may be imported already."""
    code = (
        "from tepm_opt.discrepancy.equations import Equations as old\n"
        "from tepm_opt.discrepancy.library.axis import Quantity as law\n"
        "from tepm_opt.discrepancy.adapters.equations import Equations\n"
        "from tepm_opt.discrepancy.laws.effect import Quantity\n"
        "assert old is Equations and law is Quantity\n"
    )
    done = subprocess.run([sys.executable, "-W", "always", "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "tepm_opt.discrepancy.equations is now tepm_opt.discrepancy.adapters.equations" in done.stderr
    assert "tepm_opt.discrepancy.library.axis is now tepm_opt.discrepancy.laws.axis" in done.stderr
