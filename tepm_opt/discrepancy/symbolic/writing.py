"""A law as the text of an effect file that people read, rename and keep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tepm_opt.discrepancy.symbolic.curves import Lags, Memory, Powers
from tepm_opt.discrepancy.symbolic.formula import Formula, name_term
from tepm_opt.discrepancy.symbolic.places import ALL, VARIABLE_UNITS
from tepm_opt.discrepancy.symbolic.templates import TEXTS
from tepm_opt.discrepancy.symbolic.terms import Terms
from tepm_opt.models.layout import Layout


@dataclass(frozen=True)
class EffectFile:
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


@dataclass
class _Parts:
    """Parts of an effect file: parameters as text and with first values, terms, method `law`, hook."""

    law: str = ""
    hook: str = ""
    parameters: str = ""
    start: dict[str, float] = field(default_factory=dict)
    terms: dict[str, str] = field(default_factory=dict)

    def add_coefficient(self, name: str, unit: str, value: float) -> None:
        """Add a coefficient; it may become 30 times its first size either way, and vanishes at 0."""
        probe = float(f"{value:.4g}")
        high = float(f"{30 * abs(probe):.1g}")
        self._add(name, unit, value, 0.0, -high, high)

    def add_scale(self, name: str, unit: str, value: float, room: float | None = None) -> None:
        """Add a scale with room on both sides, by default a factor of five; its null is nearby, as it has no influence."""
        probe = float(f"{value:.4g}")
        if room is None:
            self._add(name, unit, value, 0.8 * probe, probe / 5, 5 * probe)
        else:
            self._add(name, unit, value, probe - room / 5, probe - room, probe + room)

    def _add(self, name: str, unit: str, value: float, null: float, low: float, high: float) -> None:
        probe = float(f"{value:.4g}")
        self.parameters += f'        Parameter("{name}", "{unit}", null={null:.6g}, probe={probe:.6g}, low={low:.6g}, high={high:.6g}),\n'
        self.start[name] = value


def make_harmless(text: str) -> str:
    """Remove all that could end a string or comment of a program: data sets are named by others, and the file is run."""
    return "".join(c if c.isalnum() or c in " _-.,()" else " " for c in text).strip()[:80] or "a data set"


def can_be_written(formula: Formula) -> bool:
    """Whether there is a hook through which the formula's law acts in a model."""
    place, names = formula.place, [name_term(formula.place, k) for k in formula.chosen]
    if not names:
        return False
    if place.kind != "axial":
        return place.variable == "position" or (place.kind, place.variable) == ("force", "speed")
    if set(names) == {"constant"}:
        return True
    of_edges = place.variable in ("length", "rate")
    product = place.times and place.variable == "length"
    return place.variable != "time" and (not of_edges or place.target == ALL) and (not product or names == ["linear"])


def write(formula: Formula, layout: Layout, area: float, source: str) -> EffectFile:
    """The effect file of a formula.

    Args:
        formula: the law.
        layout: of the robot.
        area: of a muscle in m²: forces that pressures or tensions can make are written as pressures.
        source: name of the data, for people.
    """
    place, source = formula.place, make_harmless(source)
    name = "_".join(["law", place.kind, place.target, *place.of.split()]).lower()
    parts = _write_law(formula, area)
    where = "all actuators alike" if place.target == ALL else f"{'actuator' if place.kind == 'axial' else 'point'} {place.target}"
    everywhere = place.target == ALL and place.kind == "axial"
    called = [helper for helper, call in (("ramp", " ramp("), ("ramp_integral", "ramp_integral(")) if call in parts.law + parts.hook]
    text = TEXTS["file"].format(
        explains=f"{'force of' if place.kind == 'axial' else place.kind + ' at'} {where}, by {place.of}",
        source=source,
        at="" if everywhere else f"AT = {tuple(place.targets(layout))}  # numbers from 0: {place.target}\n\n\n",
        kind="".join(part.title() for part in name.split("_")),
        name=name,
        parameters=parts.parameters,
        law=parts.law,
        hook=parts.hook,
        helpers="".join(TEXTS[helper] for helper in called),
        imports="Effect, Memory, Parameter" if "Memory(" in parts.hook else "Effect, Parameter",
        more="from tepm_opt.models.layout import VERTICAL\n" if "VERTICAL" in parts.hook else "",
    )
    return EffectFile(name, text, parts.start, parts.terms)


def _write_law(formula: Formula, area: float) -> _Parts:
    """Parts of the effect file, by the kind of law."""
    place, shape = formula.place, formula.place.shape
    if isinstance(shape, Memory):
        return _write_memory(formula, shape, area)
    if place.variable == "speed":
        return _write_drag(formula)
    if isinstance(shape, Powers):
        return _write_displacement(formula, shape)
    if not isinstance(shape, Terms):
        raise TypeError(f"{place.label}: a law of shape {type(shape).__name__} has no formula")
    if place.kind != "axial":
        return _write_force(formula, shape)
    return _write_axial(formula, shape, area)


def _write_axial(formula: Formula, shape: Terms, area: float) -> _Parts:
    """An axial force as a change of the pressure or tension where that is possible, else of stiffness, edge energy or drag."""
    place, variable = formula.place, formula.place.variable
    if place.times == "pressure" and variable == "length":
        parts = _Parts(hook=TEXTS["stiffening"], terms={"per_pressure": "pressure * stretch"})
        parts.add_coefficient("per_pressure", "N/m/Pa", -float(formula.coefficients[0]) / shape.reference / place.most)
        return parts
    constant = {name_term(place, k) for k in formula.chosen} == {"constant"}
    as_pressure = constant or variable in ("pressure", "neighbours", "supply")
    unit, factor = ("Pa", 1 / area) if as_pressure else ("N", -1.0 if variable == "tension" else 1.0)
    parts = _write_terms(formula, shape, unit, factor)
    if variable == "length" and not as_pressure:
        parts.law, parts.hook = TEXTS["length_law"].format(sum=_write_sum(formula, shape, integral=True)), TEXTS["length_hook"]
        return parts
    parts.law = TEXTS["law"].format(sum=_write_sum(formula, shape))
    if variable == "rate" and not as_pressure:
        parts.hook = TEXTS["rate_hook"]
        return parts
    which, z, times = "pressure", "pressure[at]", ""
    if variable == "tension" and not as_pressure:
        which, z = "tension", "tension[at]"
    elif variable == "supply":
        z, times = "ca.sum1(ca.sum2(pressure)) / pressure.numel()", f" * pressure[at] / {place.most:g}"
    elif variable == "neighbours":
        z = "(ca.sum2(pressure[at[0], :]) - pressure[at]) / max(pressure.shape[1] - 1, 1)"
    each = "AT" if place.target != ALL else "range(pressure.numel())"
    result = "changed, tension" if which == "pressure" else "pressure, changed"
    parts.hook = TEXTS["input_hook"].format(which=which, result=result, each=each, z=z, times=times)
    return parts


def _name_coefficients(formula: Formula) -> list[str]:
    """Names of the coefficients, each once."""
    found: list[str] = []
    for k in formula.chosen:
        base = name_term(formula.place, k).replace(": ", "_")
        found.append(base if base not in found else f"{base}_{sum(name.startswith(base) for name in found) + 1}")
    return found


def _write_terms(formula: Formula, shape: Terms, unit: str, factor: float) -> _Parts:
    """Coefficients, in a unit that a factor converts to, and scales of all terms."""
    parts = _Parts()
    for name, k, coefficient in zip(_name_coefficients(formula), formula.chosen, formula.coefficients, strict=True):
        term = shape.terms[k % shape.size]
        parts.add_coefficient(name, unit, float(coefficient) * factor)
        if term.has_scale:
            room = shape.reference / 2 if term.kind == "ramp" else None
            parts.add_scale(f"{name}_scale", VARIABLE_UNITS[formula.place.variable], term.scale, room)
        parts.terms[name] = term.text("z", shape.reference, f"{term.scale:.4g}")
    return parts


def _write_sum(formula: Formula, shape: Terms, integral: bool = False, axis: int | None = None, variable: str = "z") -> str:
    """The law, or its integral, as a program writes it; of a vector one component."""
    parts = []
    for name, k in zip(_name_coefficients(formula), formula.chosen, strict=True):
        if axis is None or k // shape.size == axis:
            term = shape.terms[k % shape.size]
            text = (term.integral if integral else term.text)(variable, shape.reference, f'parameters["{name}_scale"]')
            parts.append(f'parameters["{name}"] * {text}')
    return " + ".join(parts) or "0.0"


def _write_memory(formula: Formula, shape: Memory, area: float) -> _Parts:
    """A lag or a play of a pressure, a tension, or a length."""
    place, variable, number = formula.place, formula.place.variable, formula.chosen[0]
    coefficient = float(formula.coefficients[0]) / shape.unit
    share = {"pressure": coefficient / area, "tension": -coefficient, "length": coefficient}[variable]
    name, scale, unit = ("lag", "time", "s") if isinstance(shape, Lags) else ("play", "distance", VARIABLE_UNITS[variable])
    parts = _Parts(terms={"share": f"{name} of the variable less the variable"})
    parts.add_coefficient("share", "N/m" if variable == "length" else "1", share)
    parts.add_scale(scale, unit, shape.scales[number])
    if variable == "length":
        parts.hook = TEXTS[f"edge_{name}"]
        return parts
    parts.law = "" if place.target == ALL else TEXTS["chosen"]
    chosen = "ca.DM.ones(*state.shape)" if place.target == ALL else "self.mask_actuators(state)"
    parts.hook = TEXTS[name].format(which=variable, chosen=chosen)
    return parts


def _write_drag(formula: Formula) -> _Parts:
    """A force on points against their motion."""
    most, sums, parts = formula.place.most, [], _Parts()
    texts = {
        "dry": f"1 / ca.sqrt(speed**2 + {formula.place.slow:.4g}**2)",
        "linear": f"1 / {most:.4g}",
        "quadratic": f"speed / {most:.4g} ** 2",
    }
    for name, coefficient in zip(_name_coefficients(formula), formula.coefficients, strict=True):
        parts.add_coefficient(name, "N", float(coefficient))
        parts.terms[name] = f"-{texts[name]} * velocity"
        sums.append(f'parameters["{name}"] * {texts[name]}')
    parts.hook = TEXTS["drag_hook"].format(sum=" + ".join(sums))
    return parts


def _write_force(formula: Formula, shape: Terms) -> _Parts:
    """A force on points by their position."""
    parts = _write_terms(formula, shape, "N", 1.0)
    if {name_term(formula.place, k).split(": ")[1] for k in formula.chosen} == {"constant"}:
        parts.hook = TEXTS["load_hook"].format(sum=", ".join(_write_sum(formula, shape, axis=axis) for axis in range(3)))
        return parts
    x, y, z = (_write_sum(formula, shape, True, axis, f"position[{axis}]") for axis in range(3))
    parts.law, parts.hook = TEXTS["force_law"].format(x=x, y=y, z=z), TEXTS["force_hook"]
    return parts


def _write_displacement(formula: Formula, shape: Powers) -> _Parts:
    """A displacement of points as they are measured, by their position."""
    parts = _Parts(hook=TEXTS["seen_hook"])
    sums: list[list[str]] = [[], [], []]
    for k, coefficient in zip(formula.chosen, formula.coefficients, strict=True):
        axis, exponents = k // shape.size, shape.exponents[k % shape.size]
        name = f"{'xyz'[axis]}_by_{''.join('xyz'[e] for e in exponents) or 'constant'}"
        parts.add_coefficient(name, "m", float(coefficient))
        parts.terms[name] = " * ".join(f"({'xyz'[e]} - {shape.centre[e]:.4g}) / {shape.half[e]:.4g}" for e in exponents) or "1.0"
        sums[axis].append(f'parameters["{name}"] * {parts.terms[name]}')
    x, y, z = (" + ".join(each) or "0.0" for each in sums)
    parts.law = TEXTS["seen_law"].format(x=x, y=y, z=z)
    return parts


def with_fitted_values(formula: Formula, written: EffectFile, values: Mapping[str, float]) -> Formula:
    """A formula with the coefficients and scales of a fit; one with memory keeps its own.

    Args:
        formula: as it was written.
        written: its effect.
        values: of the model's parameters by full name.
    """
    shape, place = formula.place.shape, formula.place
    if not isinstance(shape, Terms):
        return formula
    terms, coefficients = list(shape.terms), []
    for name, k, first in zip(_name_coefficients(formula), formula.chosen, formula.coefficients, strict=True):
        coefficients.append(first * values[f"{written.name}.{name}"] / written.start[name])
        scale = values.get(f"{written.name}.{name}_scale")
        if scale is not None:
            terms[k % shape.size] = replace(terms[k % shape.size], scale=scale)
    return replace(formula, place=replace(place, shape=replace(shape, terms=tuple(terms))), coefficients=np.array(coefficients))


def fitted_term_texts(formula: Formula, written: EffectFile) -> dict[str, str]:
    """Terms of a formula by the name of the coefficient, with the formula's scales."""
    shape = formula.place.shape
    if not isinstance(shape, Terms):
        return dict(written.terms)
    terms = {name: shape.terms[k % shape.size] for name, k in zip(_name_coefficients(formula), formula.chosen, strict=True)}
    axes = {name: name[0] if formula.place.kind != "axial" else "z" for name in terms}
    return {name: term.text(axes[name], shape.reference, f"{term.scale:.4g}") for name, term in terms.items()}


def curve(formula: Formula, values: np.ndarray, coefficients: np.ndarray | None = None) -> np.ndarray:
    """The law over values of its variable, (values,), in its unit; of laws of one variable without memory."""
    by = formula.place.shape.columns(values, values)[..., list(formula.chosen)]
    return by @ (formula.coefficients if coefficients is None else coefficients)
