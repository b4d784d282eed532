"""A law as the text of an effect file that people read, rename and keep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.discrepancy.symbolic import templates
from tepm_opt.discrepancy.symbolic.curves import Lags, Plays, Powers
from tepm_opt.discrepancy.symbolic.formula import Formula, named
from tepm_opt.discrepancy.symbolic.places import ALL, SLOW
from tepm_opt.discrepancy.symbolic.terms import SCALED, Terms
from tepm_opt.models.layout import Layout

ROOM = 30.0  # times a coefficient's size that it may come to have
NEAR = 0.8  # of a scale: its null value, which has no influence
UNITS = {"pressure": "Pa", "neighbours": "Pa", "supply": "Pa", "tension": "N", "length": "m", "rate": "m/s", "time": "s", "position": "m"}


@dataclass(frozen=True)
class Written:
    """An effect file.

    Attributes:
        name: of the effect.
        text: of the file.
        start: first values of the effect's parameters, by their own names.
        terms: of the formula, by the name of its coefficient.
    """

    name: str
    text: str
    start: Mapping[str, float]
    terms: Mapping[str, str]


@dataclass(frozen=True)
class _Value:
    """A parameter to be written: a coefficient, or a scale with the room that it has on both sides (None: a factor of five)."""

    name: str
    unit: str
    start: float
    scale: bool = False
    room: float | None = None

    @property
    def text(self) -> str:
        probe = float(f"{self.start:.4g}")
        null, low, high = 0.0, -float(f"{ROOM * abs(probe):.1g}"), float(f"{ROOM * abs(probe):.1g}")
        if self.scale and self.room is None:
            null, low, high = NEAR * probe, probe / 5, 5 * probe
        elif self.scale and self.room is not None:
            null, low, high = probe - self.room / 5, probe - self.room, probe + self.room
        return f'Parameter("{self.name}", "{self.unit}", null={null:.6g}, probe={probe:.6g}, low={low:.6g}, high={high:.6g})'


def plain(text: str) -> str:
    """A text of which nothing can end a string or a comment of a program: data sets are named by others, and the file is run."""
    return "".join(c if c.isalnum() or c in " _-.,()" else " " for c in text).strip()[:80] or "a data set"


def writable(formula: Formula, layout: Layout) -> bool:
    """Whether there is a hook through which the formula's law acts in a model."""
    place, names = formula.place, [named(formula.place, k) for k in formula.chosen]
    if not names:
        return False
    if set(names) == {"constant"} and place.kind == "axial":
        return True
    if place.kind == "axial":
        of_edges = place.variable in ("length", "rate")
        return (
            place.variable != "time"
            and (not of_edges or place.target == ALL)
            and (not place.times or place.variable != "length" or names == ["linear"])
        )
    return place.variable == "position" or (place.kind, place.variable) == ("force", "speed")


def write(formula: Formula, layout: Layout, area: float, source: str) -> Written:
    """The effect file of a formula.

    Args:
        formula: which law.
        layout: of the robot.
        area: of a muscle in m²: forces that pressures or tensions can make are written as pressures.
        source: where it was found, for people.
    """
    place, source = formula.place, plain(source)
    name = "_".join(["law", place.kind, place.target, *place.of.split()]).lower()
    values, terms, body, hook = _law(formula, layout, area)
    parameters = "".join(f"        {value.text},\n" for value in values)
    where = "all actuators alike" if place.target == ALL else f"{'actuator' if place.kind == 'axial' else 'point'} {place.target}"
    explains = f"{'force of' if place.kind == 'axial' else place.kind + ' at'} {where}, by {place.of}"
    at = (
        ""
        if place.target == ALL and place.kind == "axial"
        else f"AT = {tuple(place.targets(layout))}  # numbers from 0: {place.target}\n\n\n"
    )
    used = (("RAMP", " ramp("), ("RAMP_INTEGRAL", "ramp_integral("))
    text = templates.FILE.format(
        explains=explains,
        source=source,
        at=at,
        kind="".join(part.title() for part in name.split("_")),
        name=name,
        parameters=parameters,
        law=body,
        hook=hook,
        helpers="".join(getattr(templates, helper) for helper, call in used if call in body + hook),
        imports="Effect, Memory, Parameter" if "Memory(" in hook else "Effect, Parameter",
        more="from tepm_opt.models.layout import VERTICAL\n" if "VERTICAL" in hook else "",
    )
    return Written(name, text, {value.name: value.start for value in values}, terms)


def _law(formula: Formula, layout: Layout, area: float) -> tuple[list[_Value], dict[str, str], str, str]:
    """Parameters, the formula's terms, the text of `law` and of the hook."""
    place, shape = formula.place, formula.place.shape
    only = {named(place, k) for k in formula.chosen}
    if isinstance(shape, Lags | Plays):
        return _memory(formula, shape, area)
    if place.variable == "speed":
        return _drag(formula)
    if isinstance(shape, Powers):
        return _seen(formula, shape)
    if not isinstance(shape, Terms):
        raise TypeError(f"{place.label}: a law of shape {type(shape).__name__} has no formula")
    if place.kind != "axial":
        return _force(formula, shape)
    as_pressure = place.variable in ("pressure", "neighbours", "supply") or only == {"constant"}
    if place.times == "pressure" and place.variable == "length":
        return _stiffening(formula, shape)
    unit, factor = ("Pa", 1 / area) if as_pressure else ("N", -1.0 if place.variable == "tension" else 1.0)
    values, terms = _terms(formula, shape, unit, factor)
    if place.variable == "length" and not as_pressure:
        return values, terms, templates.LENGTH_LAW.format(sum=_sum(formula, shape, integral=True)), templates.LENGTH_HOOK
    if place.variable == "rate" and not as_pressure:
        return values, terms, templates.LAW.format(sum=_sum(formula, shape)), templates.RATE_HOOK
    which, z, times = "pressure", "pressure[at]", ""
    if place.variable == "tension" and not as_pressure:
        which, z = "tension", "tension[at]"
    elif place.variable == "supply":
        z, times = "ca.sum1(ca.sum2(pressure)) / pressure.numel()", f" * pressure[at] / {place.most:g}"
    elif place.variable == "neighbours":
        z = "(ca.sum2(pressure[at[0], :]) - pressure[at]) / max(pressure.shape[1] - 1, 1)"
    each = "AT" if place.target != ALL else "range(pressure.numel())"
    result = "changed, tension" if which == "pressure" else "pressure, changed"
    hook = templates.INPUT_HOOK.format(which=which, result=result, each=each, z=z, times=times)
    return values, terms, templates.LAW.format(sum=_sum(formula, shape)), hook


def _names(formula: Formula) -> list[str]:
    """Names of the coefficients, each once."""
    found: list[str] = []
    for k in formula.chosen:
        base = named(formula.place, k).replace(": ", "_")
        found.append(base if base not in found else f"{base}_{sum(name.startswith(base) for name in found) + 1}")
    return found


def _terms(formula: Formula, shape: Terms, unit: str, factor: float) -> tuple[list[_Value], dict[str, str]]:
    values, terms = [], {}
    for name, k, coefficient in zip(_names(formula), formula.chosen, formula.coefficients, strict=True):
        term = shape.terms[k % shape.size]
        values.append(_Value(name, unit, float(coefficient) * factor))
        if term.kind in SCALED:
            room = shape.reference / 2 if term.kind == "ramp" else None
            values.append(_Value(f"{name}_scale", UNITS[formula.place.variable], term.scale, True, room))
        terms[name] = term.text("z", shape.reference, f"{term.scale:.4g}")
    return values, terms


def _sum(formula: Formula, shape: Terms, integral: bool = False, axis: int | None = None, variable: str = "z") -> str:
    """The law, or its integral, as a program writes it; of a vector one component."""
    parts = []
    for name, k in zip(_names(formula), formula.chosen, strict=True):
        if axis is None or k // shape.size == axis:
            term = shape.terms[k % shape.size]
            text = (term.integral if integral else term.text)(variable, shape.reference, f'parameters["{name}_scale"]')
            parts.append(f'parameters["{name}"] * {text}')
    return " + ".join(parts) or "0.0"


def _memory(formula: Formula, shape: Lags | Plays, area: float) -> tuple[list[_Value], dict[str, str], str, str]:
    """A lag or a play of a pressure, a tension, or a length."""
    place = formula.place
    k, coefficient = formula.chosen[0], float(formula.coefficients[0]) / shape.unit
    share = {"pressure": coefficient / area, "tension": -coefficient, "length": coefficient}[place.variable]
    unit = {"pressure": "1", "tension": "1", "length": "N/m"}[place.variable]
    lag = isinstance(shape, Lags)
    scale = shape.times[k] if isinstance(shape, Lags) else shape.radii[k]
    values = [_Value("share", unit, share), _Value("time" if lag else "distance", "s" if lag else UNITS[place.variable], scale, scale=True)]
    terms = {"share": "lag of the variable less the variable" if lag else "play of the variable less the variable"}
    if place.variable == "length":
        return values, terms, "", (templates.EDGE_LAG if lag else templates.EDGE_PLAY)
    chosen = "ca.DM.ones(*state.shape)" if place.target == ALL else "self.chosen(state)"
    return (
        values,
        terms,
        "" if place.target == ALL else templates.CHOSEN,
        (templates.LAG if lag else templates.PLAY).format(which=place.variable, chosen=chosen),
    )


def _stiffening(formula: Formula, shape: Terms) -> tuple[list[_Value], dict[str, str], str, str]:
    value = -float(formula.coefficients[0]) / shape.reference / formula.place.most
    return [_Value("per_pressure", "N/m/Pa", value)], {"per_pressure": "pressure * stretch"}, "", templates.STIFFENING


def _drag(formula: Formula) -> tuple[list[_Value], dict[str, str], str, str]:
    """A force on points against their motion."""
    most = formula.place.most
    texts = {"dry": f"1 / ca.sqrt(speed**2 + {SLOW * most:.4g}**2)", "linear": f"1 / {most:.4g}", "quadratic": f"speed / {most:.4g} ** 2"}
    terms = {name: texts[name] for name in _names(formula)}
    values = [_Value(name, "N", float(c)) for name, c in zip(terms, formula.coefficients, strict=True)]
    total = " + ".join(f'parameters["{name}"] * {text}' for name, text in terms.items())
    return values, {name: f"-{text} * velocity" for name, text in terms.items()}, "", templates.DRAG_HOOK.format(sum=total)


def _force(formula: Formula, shape: Terms) -> tuple[list[_Value], dict[str, str], str, str]:
    """A force on points by their position."""
    values, terms = _terms(formula, shape, "N", 1.0)
    if {named(formula.place, k).split(": ")[1] for k in formula.chosen} == {"constant"}:
        return values, terms, "", templates.LOAD_HOOK.format(sum=", ".join(_sum(formula, shape, axis=axis) for axis in range(3)))
    x, y, z = (_sum(formula, shape, True, axis, f"position[{axis}]") for axis in range(3))
    return values, terms, templates.FORCE_LAW.format(x=x, y=y, z=z), templates.FORCE_HOOK


def _seen(formula: Formula, shape: Powers) -> tuple[list[_Value], dict[str, str], str, str]:
    """A displacement of points as they are measured, by their position."""
    values, terms = [], {}
    sums: list[list[str]] = [[], [], []]
    for k, coefficient in zip(formula.chosen, formula.coefficients, strict=True):
        axis, exponents = k // shape.size, shape.exponents[k % shape.size]
        factors = "".join("xyz"[e] for e in exponents) or "constant"
        name = f"{'xyz'[axis]}_by_{factors}"
        values.append(_Value(name, "m", float(coefficient)))
        text = " * ".join(f"({'xyz'[e]} - {shape.centre[e]:.4g}) / {shape.half[e]:.4g}" for e in exponents) or "1.0"
        terms[name] = text
        sums[axis].append(f'parameters["{name}"] * {text}')
    lines = [" + ".join(each) or "0.0" for each in sums]
    return values, terms, templates.SEEN_LAW.format(x=lines[0], y=lines[1], z=lines[2]), templates.SEEN_HOOK


def refitted(formula: Formula, written: Written, values: Mapping[str, float]) -> Formula:
    """A formula with the coefficients and scales of a fit; one that remembers keeps its own.

    Args:
        formula: as it was written.
        written: its effect.
        values: of the model's parameters by full name.
    """
    shape, place = formula.place.shape, formula.place
    if not isinstance(shape, Terms):
        return formula
    terms, coefficients = list(shape.terms), []
    for name, k, first in zip(_names(formula), formula.chosen, formula.coefficients, strict=True):
        coefficients.append(first * values[f"{written.name}.{name}"] / written.start[name])
        scale = values.get(f"{written.name}.{name}_scale")
        if scale is not None:
            terms[k % shape.size] = replace(terms[k % shape.size], scale=scale)
    return replace(formula, place=replace(place, shape=replace(shape, terms=tuple(terms))), coefficients=np.array(coefficients))


def refitted_texts(formula: Formula, written: Written) -> dict[str, str]:
    """The terms of a formula as `Written.terms` has them, with the formula's scales."""
    shape = formula.place.shape
    if not isinstance(shape, Terms):
        return dict(written.terms)
    terms = {name: shape.terms[k % shape.size] for name, k in zip(_names(formula), formula.chosen, strict=True)}
    axes = {name: name[0] if formula.place.kind != "axial" else "z" for name in terms}
    return {name: term.text(axes[name], shape.reference, f"{term.scale:.4g}") for name, term in terms.items()}


def curve(formula: Formula, values: np.ndarray, coefficients: np.ndarray | None = None) -> np.ndarray:
    """The law over values of its variable, (values,), in its unit; of laws of one variable without memory."""
    by = formula.place.shape.columns(values, values)[..., list(formula.chosen)]
    return by @ (formula.coefficients if coefficients is None else coefficients)
