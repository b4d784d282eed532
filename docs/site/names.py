"""Pages on the names of `tepm_opt`: those that its stub lists, by the package they are at home in."""

from __future__ import annotations

import re
from pathlib import Path

STUB = Path(__file__).resolve().parents[2] / "tepm_opt" / "__init__.pyi"
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
    "outcomes": "outcomes and errors",
}
"""Of packages, in the order in which they are shown."""


def names() -> dict[str, list[str]]:
    """Modules and names of the stub, such as "solvers.statics.solve_statics", by package."""
    found: dict[str, list[str]] = {name: [] for name in TITLES}
    for module, name in re.findall(r"^from \.([\w.]+) import (\w+) as \2$", STUB.read_text(encoding="utf-8"), re.M):
        found[module.split(".")[0] if "." in module else "outcomes"].append(f"{module}.{name}")
    return found


def pages() -> dict[str, str]:
    """One page a package: its names with their docstrings, which Sphinx fills in."""
    return {f"api/{package}.md": _page(TITLES[package], listed) for package, listed in names().items()}


def _page(title: str, listed: list[str]) -> str:
    text = [f"# Python: {title}", "", "All of these are imported from `tepm_opt` itself.", ""]
    for name in listed:
        short = name.rpartition(".")[2]
        kind = "autoclass" if short[0].isupper() else "autofunction"
        members = ["   :members:"] if kind == "autoclass" else []
        text += [f"## {short}", "", "```{eval-rst}", f".. {kind}:: tepm_opt.{name}", *members, "```", ""]
    return "\n".join(text)
