"""Pages on the names of `tepm_opt` and `tepm_opt.studies`: those that their stubs list, by the package they are at home in."""

from __future__ import annotations

import re
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "tepm_opt"
STUDIES = "studies"
TITLES = {
    "jobs": "what commands do",
    "models": "robots and models",
    "solvers": "solvers",
    "control": "control",
    "discrepancy": "verdicts",
    "data": "data",
    "recording": "recording",
    "hw": "rigs",
    "exports": "exports",
    "report": "pages",
    STUDIES: "studies",
    "outcomes": "outcomes and errors",
}
"""Titles of packages, in the order in which they are shown."""


def names() -> dict[str, list[str]]:
    """Modules and names of the stubs, such as "solvers.mechanics.statics.solve_statics", by package."""
    found: dict[str, list[str]] = {name: [] for name in TITLES}
    for module, name in listed_in(PACKAGE / "__init__.pyi"):
        found[module.split(".")[0] if "." in module else "outcomes"].append(f"{module}.{name}")
    found[STUDIES] = [f"{STUDIES}.{module}.{name}" for module, name in listed_in(PACKAGE / STUDIES / "__init__.pyi")]
    return found


def listed_in(stub: Path) -> list[tuple[str, str]]:
    """Modules and names that a stub lists."""
    return re.findall(r"^from \.([\w.]+) import (\w+) as \2$", stub.read_text(encoding="utf-8"), re.M)


def pages() -> dict[str, str]:
    """One page a package: its names with their docstrings, which Sphinx fills in."""
    homes = {package: "from `tepm_opt.studies`" if package == STUDIES else "from `tepm_opt` itself" for package in TITLES}
    return {f"api/{package}.md": _page(TITLES[package], homes[package], listed) for package, listed in names().items()}


def _page(title: str, home: str, listed: list[str]) -> str:
    text = [f"# Python: {title}", "", f"All of these are imported {home}.", ""]
    for name in listed:
        short = name.rpartition(".")[2]
        kind = "autoclass" if short[0].isupper() else "autofunction"
        members = ["   :members:"] if kind == "autoclass" else []
        text += [f"## {short}", "", "```{eval-rst}", f".. {kind}:: tepm_opt.{name}", *members, "```", ""]
    return "\n".join(text)
