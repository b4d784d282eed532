"""What an effect's hooks compute, as equations: the hooks are called with symbols, and what CasADi then holds is written as TeX."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from tepm_opt.models.effect import BEGAN, CLOCK, Context, Effect, Properties
from tepm_opt.models.layout import VERTICAL, Layout
from tepm_opt.models.memories import Memory, Play, Saturating
from tepm_opt.models.model import Model

LONGEST = 330
"""Characters of TeX beyond which an equation tells a reader less than the words do."""

SUM, PRODUCT, POWER, WHOLE = 1, 2, 3, 4  # how tightly a term holds together
INFIX = {
    ca.OP_ADD: (" + ", SUM), ca.OP_LT: (" < ", 0), ca.OP_LE: (r" \le ", 0), ca.OP_EQ: (" = ", 0), ca.OP_NE: (r" \ne ", 0),
    ca.OP_AND: (r" \wedge ", 0), ca.OP_OR: (r" \vee ", 0),
}  # fmt: skip
NAMED = {
    ca.OP_SIN: r"\sin", ca.OP_COS: r"\cos", ca.OP_TANH: r"\tanh", ca.OP_LOG: r"\ln", ca.OP_SIGN: r"\operatorname{sign}", ca.OP_TAN: r"\tan",
    ca.OP_FMAX: r"\max", ca.OP_FMIN: r"\min", ca.OP_ATAN: r"\arctan",
}  # fmt: skip

NUMBER = re.compile(r"-?[\d.]+")
NOTHING = 1e-12
"""Constants below it are rounding."""


class Term(NamedTuple):
    """A part of an equation.

    Attributes:
        text: as TeX.
        tightness: how tightly it holds together.
        case: of what is only there under a condition, the condition and the value.
    """

    text: str
    tightness: int
    case: tuple[str, str] | None = None

    def within(self, tightness: int) -> str:
        """The text, in brackets where it does not hold together tightly enough."""
        return self.text if self.tightness >= tightness else rf"\left({self.text}\right)"


ZERO = Term("0", WHOLE)
SIGNS = (
    (r" - \\left\(-([\d.]+)\\right\)", r" + \1"),
    (r"-\\left\(-([\d.]+)\\right\)", r"\1"),
    (r"-([\d.]+) \\, \\left\(-([\d.]+)\\right\)", r"\1 \\cdot \2"),
    (r"\\left\((-[\d.]+)\\right\) \\,", r"\1 \\,"),
)
"""Two minus signs that are none."""


def number(value: float) -> Term:
    """A constant with four digits."""
    text = f"{value:.4g}" if abs(value) > NOTHING else "0"
    if "e" in text:
        digits, power = text.split("e")
        return Term(rf"{digits} \cdot 10^{{{int(power)}}}".removeprefix(r"1 \cdot "), PRODUCT)
    return Term(text, SUM if value < 0 else WHOLE)


def applied(code: int, terms: list[Term]) -> Term:
    """One of CasADi's operations on terms.

    Raises:
        KeyError: an operation that has no form here.
    """
    x, *rest = terms
    y = rest[0] if rest else x
    if code == ca.OP_ADD and ZERO in terms:
        return y if x == ZERO else x
    if code == ca.OP_MUL and ZERO in terms:
        return ZERO
    if code == ca.OP_ADD and x.case and y.case and y.case[0] == rf"\neg \left({x.case[0]}\right)":
        cases = rf"\begin{{cases}} {x.case[1]} & {x.case[0]} \\ {y.case[1]} & \text{{otherwise}} \end{{cases}}"
        return Term(cases, SUM)
    if code in INFIX:
        sign, tightness = INFIX[code]
        return Term(sign.join(each.within(tightness) for each in terms).replace("+ -", "- "), tightness)
    if code in NAMED:
        return Term(rf"{NAMED[code]}\left({', '.join(each.text for each in terms)}\right)", WHOLE)
    minus = rf"-\left({x.text}\right)" if x.text.startswith("-") else f"-{x.within(PRODUCT)}"
    if NUMBER.fullmatch(x.text):
        minus = f"-{x.text}".removeprefix("--")
    forms = {
        ca.OP_ASSIGN: x,
        ca.OP_NEG: Term(minus, SUM),
        ca.OP_NOT: Term(rf"\neg \left({x.text}\right)", PRODUCT),
        ca.OP_SQ: Term(f"{x.within(WHOLE)}^{{2}}", POWER),
        ca.OP_TWICE: Term(rf"2 \, {x.within(PRODUCT)}", PRODUCT),
        ca.OP_SQRT: Term(rf"\sqrt{{{x.text}}}", WHOLE),
        ca.OP_INV: Term(rf"\frac{{1}}{{{x.text}}}", PRODUCT),
        ca.OP_EXP: Term(f"e^{{{x.text}}}", POWER),
        ca.OP_EXPM1: Term(f"e^{{{x.text}}} - 1", SUM),
        ca.OP_LOG1P: Term(rf"\ln\left(1 + {x.text}\right)", WHOLE),
        ca.OP_FABS: Term(rf"\left|{x.text}\right|", WHOLE),
        ca.OP_SUB: Term(f"{x.within(SUM)} - {y.within(PRODUCT)}", SUM),
        ca.OP_MUL: Term(rf"{x.within(PRODUCT)} \, {y.within(PRODUCT)}", PRODUCT),
        ca.OP_DIV: Term(rf"\frac{{{x.text}}}{{{y.text}}}", PRODUCT),
        ca.OP_POW: Term(f"{x.within(WHOLE)}^{{{y.text}}}", POWER),
        ca.OP_CONSTPOW: Term(f"{x.within(WHOLE)}^{{{y.text}}}", POWER),
        ca.OP_IF_ELSE_ZERO: Term(rf"\left[{x.text}\right] {y.within(PRODUCT)}", PRODUCT, (x.text, y.text)),
    }
    return forms[code]


def tex(expression: ca.SX, names: Mapping[str, str]) -> str:
    """A scalar expression as TeX; symbols by their name in CasADi are written as `names` says."""
    symbols = ca.symvar(expression)
    function = ca.Function("f", symbols, [ca.densify(expression)], {"cse": False})
    terms: dict[int, Term] = {}
    result = ZERO
    for k in range(function.n_instructions()):
        code, where, into = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if code == ca.OP_CONST:
            terms[into[0]] = number(function.instruction_constant(k))
        elif code == ca.OP_INPUT:
            name = symbols[where[0]].name()
            terms[into[0]] = Term(names[name], WHOLE)
        elif code == ca.OP_OUTPUT:
            result = terms[where[0]]
        else:
            terms[into[0]] = applied(code, [terms[each] for each in where])
    for pattern, better in SIGNS:
        result = result._replace(text=re.sub(pattern, better, result.text))
    return result.text


class Hooks:
    """One effect's hooks, called with symbols in a robot.

    Attributes:
        names: TeX of all symbols, by their names in CasADi.
    """

    def __init__(self, effect: Effect, model: Model) -> None:
        self.effect = effect
        self.layout = layout = Layout.from_robot(model.robot)
        mount = model.robot.mount
        details = layout.details(effect.detail)
        self.context = Context(
            layout, min(2, len(details) - 1) if details else None, mount.rotation, np.array(mount.base_position_m),
            mount.rotation.T @ np.array(mount.gravity_m_per_s2),
        )  # fmt: skip
        self.names: dict[str, str] = {}
        own = [parameter.name for parameter in effect.parameters_of(layout)]
        shown = {name: rf"\mathrm{{{_spelt(name)}}}" for name in own} | ({CLOCK: "t", BEGAN: "t_0"} if effect.timed else {})
        self.parameters = {name: self._symbol(text) for name, text in shown.items()}
        self.at = 0 if self.context.detail is None or effect.detail != "actuator" else self.context.detail
        self.hj = f"1{self.at + 1}"
        shape = (layout.modules, layout.actuators)
        self.pressure = self._matrix(shape, lambda h, j: f"p_{{{h + 1}{j + 1}}}")
        self.tension = self._matrix(shape, lambda h, j: rf"\lambda_{{{h + 1}{j + 1}}}")

    def _symbol(self, shown: str) -> ca.SX:
        name = f"symbol_{len(self.names)}"
        self.names[name] = shown
        return ca.SX.sym(name)

    def _matrix(self, shape: tuple[int, int], shown: Callable[[int, int], str]) -> ca.SX:
        rows = [[self._symbol(shown(i, j)) for j in range(shape[1])] for i in range(shape[0])]
        return ca.vertcat(*(ca.horzcat(*row) for row in rows))

    def equations(self) -> Iterator[tuple[str, str]]:
        """What is computed in words, and its equation as TeX; those too long to be read have an empty one."""
        for words, left, expression in (*self._maps(), *self._properties(), *self._energies(), *self._memories(), *self._others()):
            try:
                right = tex(expression, self.names)
            except KeyError:
                right = ""
            yield words, f"{left} = {right}" if right and len(right) <= LONGEST else ""

    def _maps(self) -> Iterator[tuple[str, str, ca.SX]]:
        pressure, tension = self.effect.inputs(self.pressure, self.tension, self.parameters, self.context)
        for words, left, before, after in (
            ("effective pressure", f"p_{{{self.hj}}}'", self.pressure, pressure),
            ("effective tension", rf"\lambda_{{{self.hj}}}'", self.tension, tension),
        ):
            if not ca.is_equal(before[0, self.at], after[0, self.at], 3):
                yield words, left, after[0, self.at]

    def _network(self) -> Properties:
        edges, n = len(self.layout.edges), self.layout.levels
        stiffness, damping, rest = (ca.repmat(self._symbol(shown), edges, n) for shown in ("k", "c", r"\ell_0"))
        return Properties(stiffness, damping, rest, ca.repmat(self._symbol("m"), n, 1), self.pressure, self.tension)

    def _properties(self) -> Iterator[tuple[str, str, ca.SX]]:
        before = self._network()
        after = replace(before, **{name: ca.SX(getattr(before, name)) for name in ("stiffness", "damping", "rest", "mass")})
        self.effect.properties(after, self.parameters, self.context)
        level, last = self.layout.segments - 1, self.layout.levels - 1
        for words, left, name, row, column in (
            ("stiffness of a muscle's segment below the plate", "k'", "stiffness", self.at, level),
            ("damping of a muscle's segment", "c'", "damping", self.at, 0),
            ("rest length of a muscle's segment", r"\ell_0'", "rest", self.at, 0),
            ("mass of a node within the body", "m'", "mass", 0, 0),
            ("mass of a node of the tip", "m_n'", "mass", last, 0),
            ("pressure that acts", f"p_{{{self.hj}}}'", "pressure", 0, self.at),
            ("tension that acts", rf"\lambda_{{{self.hj}}}'", "tension", 0, self.at),
        ):
            old, new = getattr(before, name)[row, column], getattr(after, name)[row, column]
            if not ca.is_equal(old, new, 3):
                yield words, left, new
        if self.effect.has("loads"):
            external = self._matrix((3, self.layout.points), lambda i, k: f"f_{{{'xyz'[i]}{k + 1}}}")
            force = self.effect.loads(before, external, self.parameters, self.context)
            for axis in range(3):
                if not force[axis, last].is_zero():
                    yield f"force on the tip's level along {'xyz'[axis]} of the base", f"F_{'xyz'[axis]}", force[axis, last]

    def _edge(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        return self._symbol(r"\ell"), self._symbol(r"\ell_0"), self._symbol(r"\dot\ell")

    def _energies(self) -> Iterator[tuple[str, str, ca.SX]]:
        length, rest, rate = self._edge()
        edge = next(each for each in self.layout.edges if each.kind == VERTICAL and each.a[1] == self.at)
        tension = self._symbol(r"\lambda")
        if self.effect.has("edge_energy"):
            yield "energy of a muscle's segment", "V", ca.SX(self.effect.edge_energy(edge, length, rest, self.parameters, self.context))
        if self.effect.has("tendon_energy"):
            yield "energy of the tendon along it", "V", self.effect.tendon_energy(length, rest, tension, self.parameters, self.context)
        if self.effect.has("edge_drag"):
            yield "pull of a muscle's segment", "F", ca.SX(self.effect.edge_drag(edge, length, rate, self.parameters, self.context))

    def _memories(self) -> Iterator[tuple[str, str, ca.SX]]:
        length, rest, rate = self._edge()
        shape = (self.effect.branches * self.layout.modules, self.layout.actuators)
        signal, change, state = (ca.repmat(self._symbol(shown), *shape) for shown in ("u", r"\dot u", "y"))
        value = state[0, 0]
        for hook, what in (("pressure_memory", "pressure, to which y is added"), ("tension_memory", "tension, to which y is added")):
            if self.effect.has(hook):
                memory = getattr(self.effect, hook)(signal, change, state, self.parameters, self.context)
                yield from _of_memory(what, memory, self.at, value)
        if self.effect.has("edge_memory"):
            edge = next(each for each in self.layout.edges if each.kind == VERTICAL)
            own = {name: self._symbol(shown) for name, shown in OF_EDGE.items()}
            found = self.effect.edge_memory(edge, length, rate, {**own, "rest": rest}, self.parameters, self.context)
            parts = (found,) if isinstance(found, Memory) else found or ()
            for k, memory in enumerate(parts, start=1):
                of = f", part {k} of {len(parts)}" if len(parts) > 1 else ""
                yield from _of_memory(f"muscle's segment, y being a force that pulls its ends together{of}", memory, 0, value)

    def _others(self) -> Iterator[tuple[str, str, ca.SX]]:
        if self.effect.has("delay"):
            yield "delay of the commands", "T", ca.SX(self.effect.delay(self.parameters))
        if self.effect.has("outputs"):
            points = self._matrix((3, self.layout.points), lambda i, k: f"{'xyz'[i]}_{{s{k + 1}}}")
            seen = self.effect.outputs(points, self.parameters, self.context)
            k = self.context.detail if self.effect.detail == "point" else 0
            for axis in range(3):
                if not ca.is_equal(seen[axis, k], points[axis, k], 3):
                    yield f"measured {'xyz'[axis]} of s_{k + 1}", f"{'xyz'[axis]}_{{s{k + 1}}}'", seen[axis, k]


OF_EDGE = {"stiffness": "k", "damping": "c", "axial": "F_a", "tension": r"\lambda"}


def _of_memory(what: str, memory: Memory | Play | None, at: int, state: ca.SX) -> Iterator[tuple[str, str, ca.SX]]:
    if isinstance(memory, Play):
        yield f"limit of the play y of a {what}", r"\bar y", memory.limit[0, at]
        yield "path over which it comes to its limit", "d", memory.distance[0, at]
    elif isinstance(memory, Memory):
        scale = memory.scale[0, at]
        if isinstance(memory, Saturating):
            scale += memory.slowing(ca.repmat(state, *memory.scale.shape), ca.SX(0))[0, at] * ca.fmax(ca.fabs(state), memory.opening)
        yield f"memory y of a {what}", r"\dot y", memory.drive[0, at] - memory.decay[0, at] / scale * state


def _spelt(name: str) -> str:
    return re.sub("_", r"\\,", name)
