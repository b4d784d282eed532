"""Report of a law: a paragraph, plain data, a page in Markdown beside the effect file."""

from __future__ import annotations

from typing import Any

from tepm_opt.discrepancy.symbolic.curves import Spline
from tepm_opt.discrepancy.symbolic.invent import Extrapolation, Invention
from tepm_opt.discrepancy.symbolic.places import VARIABLE_UNITS
from tepm_opt.discrepancy.symbolic.terms import Terms
from tepm_opt.discrepancy.symbolic.writing import fitted_term_texts


def formula_text(law: Invention) -> str:
    """The formula with the fitted values: "-1.967e+04 Pa * (z / 300000)", z being the variable of the law."""
    own = f"{law.written.name}."
    values = {name.removeprefix(own): value for name, value in law.estimate.named.items() if name.startswith(own)}
    units = {f.name.removeprefix(own): f.unit for f in law.estimate.problem.free if f.name.startswith(own)}
    terms = fitted_term_texts(law.fitted_formula, law.written)
    return " + ".join(f"{values[name]:.4g} {units[name]} * {term}" for name, term in terms.items()).replace("ca.", "")


def curves(law: Invention) -> tuple[Terms, Spline] | None:
    """The formula and the smooth law as functions of one variable, which can be drawn; None where they are not."""
    formula, smooth = law.formula.place.shape, law.scored.place.shape
    if law.formula.place.kind == "axial" and isinstance(formula, Terms) and isinstance(smooth, Spline):
        return formula, smooth
    return None


def paragraph(law: Invention) -> str:
    """The law in words."""
    place, (before, after) = law.formula.place, law.errors
    where = "all actuators alike" if place.target == "all" and place.kind == "axial" else place.target
    text = (
        f"No known effect explains what is left, but a law does: {place.kind} of {where} by {place.of}, {formula_text(law)}. "
        f"It closes {law.closes:.0%} of the structure left in data that it was not fitted to; error {1e3 * before:.3g} mm without it, "
        f"{1e3 * after:.3g} mm with it."
    )
    return " ".join([text, *(_describe_extrapolation(run) for run in law.beyond)])


def _describe_extrapolation(run: Extrapolation) -> str:
    low, high = run.visited
    unit = VARIABLE_UNITS.get(run.variable, "")
    here = f"{run.variable} {run.low:.3g} … {run.high:.3g} {unit}"
    return f"It extrapolates in {run.file}: {here} where it was fitted over {low:.3g} … {high:.3g} {unit}."


def as_json(law: Invention) -> dict[str, Any]:
    """Content of "law" in verdict.json."""
    place = law.formula.place
    return {
        "name": law.written.name,
        "kind": place.kind,
        "target": place.target,
        "depends_on": place.of,
        "formula": formula_text(law),
        "parameters": {
            f.name.rsplit(".", 1)[1]: {"value": float(f"{value:.6g}"), "std": float(f"{std:.3g}"), "unit": f.unit}
            for f, value, std in zip(law.estimate.problem.free, law.estimate.values, law.estimate.std, strict=True)
            if f.name.startswith(f"{law.written.name}.")
        },
        "closes": float(f"{law.closes:.6g}"),
        "rmse_m": {"without": float(f"{law.errors[0]:.6g}"), "with": float(f"{law.errors[1]:.6g}")},
        "extrapolates": [
            {"run": run.file, "variable": run.variable, "low": run.low, "high": run.high, "visited": list(run.visited)}
            for run in law.beyond
        ],
    }


def page(law: Invention, figure: str | None) -> str:
    """A page in Markdown about a law.

    Args:
        law: what was found.
        figure: name of the file with its curve, where it has one.
    """
    lines = [f"# {law.written.name}", "", paragraph(law), ""]
    lines += [f"![the law with its band]({figure})", ""] if figure else []
    lines += ["| parameter | value | standard deviation | unit |", "| --- | --- | --- | --- |"]
    for f, value, std in zip(law.estimate.problem.free, law.estimate.values, law.estimate.std, strict=True):
        lines.append(f"| {f.name} | {value:.6g} | {std:.2g} | {f.unit} |")
    lines += ["", "What smooth laws at other places would predict of left-out data, to first order:", ""]
    lines += ["| place | part of the structure left |", "| --- | --- |"]
    lines += [f"| {each.place.label} | {each.closes:.1%} |" for each in law.places[:8]]
    used = f"`--effects {law.file.name}`, with `--model {law.file.stem}.toml` for the values found"
    lines += ["", f"Used by every command that takes a model: {used}. Rename file, class and effect when you know what it is."]
    return "\n".join(lines) + "\n"
