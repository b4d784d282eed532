"""C of CasADi's functions, written from their lists of instructions: short functions in a row, with places and numbers as data.

The time in which a compiler hands out registers grows faster than the length of a function, so that a long straight line is cut into
pieces; what later ones need is handed on in an array. Where arguments and results stand, and a robot's numbers, are tables beside the
text. The text, and with it the object file, is the same for all models with the same formulas.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby

import casadi as ca

PIECE = 600
"""Instructions of a piece: of half of that, RK4 takes a twentieth longer; longer ones take longer to compile."""
PIECES = 7
"""Pieces of a text that is compiled apart."""
SMALL = 16
"""Multiples of an eighth up to this number are formulas' and stay in the text; all other numbers are data."""

_OPERATORS = {
    **{ca.OP_ASSIGN: "{0}", ca.OP_NEG: "-{0}", ca.OP_TWICE: "2 * {0}", ca.OP_SQ: "{0} * {0}", ca.OP_INV: "1 / {0}"},
    **{ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}", ca.OP_DIV: "{0} / {1}"},
}
_LOGIC = {
    **{ca.OP_LT: "less", ca.OP_LE: "most", ca.OP_EQ: "same", ca.OP_NE: "other", ca.OP_AND: "and", ca.OP_OR: "or", ca.OP_NOT: "not"},
    **{ca.OP_IF_ELSE_ZERO: "if", ca.OP_SIGN: "sign"},
}
_OF_ONE = (
    *("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh"),
    *("atanh", "erf", "fabs", "floor", "ceil"),
)
_OF_TWO = ("pow", "fmod", "copysign", "fmin", "fmax", "atan2", "hypot", "remainder")
_FUNCTIONS = {getattr(ca, f"OP_{name.upper()}"): name for name in (*_OF_ONE, *_OF_TWO)} | {ca.OP_CONSTPOW: "pow"}

PREAMBLE = "\n".join(
    (
        """#include <math.h>
#include <string.h>
typedef double vector __attribute__((vector_size(8 * LANES), aligned(8))); /* anywhere in arrays of doubles */
typedef long long lanes_mask __attribute__((vector_size(8 * LANES), aligned(8)));
static inline double one_less(double x, double y) { return x < y; }
static inline double one_most(double x, double y) { return x <= y; }
static inline double one_same(double x, double y) { return x == y; }
static inline double one_other(double x, double y) { return x != y; }
static inline double one_and(double x, double y) { return x != 0 && y != 0; }
static inline double one_or(double x, double y) { return x != 0 || y != 0; }
static inline double one_not(double x) { return x == 0; }
static inline double one_if(double x, double y) { return x != 0 ? y : 0; }
static inline double one_sign(double x) { return x < 0 ? -1 : x > 0 ? 1 : x; }
static inline vector lanes_where(lanes_mask m, vector x) { return (vector)(m & (lanes_mask)x); } /* 0 elsewhere */
static inline vector lanes_true(lanes_mask m) { return lanes_where(m, (vector){0} + 1); }
static inline vector lanes_less(vector x, vector y) { return lanes_true((lanes_mask)(x < y)); }
static inline vector lanes_most(vector x, vector y) { return lanes_true((lanes_mask)(x <= y)); }
static inline vector lanes_same(vector x, vector y) { return lanes_true((lanes_mask)(x == y)); }
static inline vector lanes_other(vector x, vector y) { return lanes_true((lanes_mask)(x != y)); }
static inline vector lanes_and(vector x, vector y) { return lanes_true((lanes_mask)(x != 0) & (lanes_mask)(y != 0)); }
static inline vector lanes_or(vector x, vector y) { return lanes_true((lanes_mask)(x != 0) | (lanes_mask)(y != 0)); }
static inline vector lanes_not(vector x) { return lanes_true((lanes_mask)(x == 0)); }
static inline vector lanes_if(vector x, vector y) { return lanes_where((lanes_mask)(x != 0), y); }
static inline vector lanes_sign(vector x) { for (int i = 0; i < LANES; i++) x[i] = one_sign(x[i]); return x; }
#define OF_ONE(f) static inline vector lanes_##f(vector x) { for (int i = 0; i < LANES; i++) x[i] = f(x[i]); return x; }
#define OF_TWO(f) static inline vector lanes_##f(vector x, vector y) { for (int i = 0; i < LANES; i++) x[i] = f(x[i], y[i]); return x; }""",
        *(f"OF_ONE({name})" for name in _OF_ONE),
        *(f"OF_TWO({name})" for name in _OF_TWO),
    )
)
"""Before all kernels, behind the macros LANES, doubles in a vector, and FORMULAS and CALL, how both parts of a kernel are linked."""
_HEAD = (
    "FORMULAS void {name}(const {type} *const *arg, {type} *const *res, const int *in, const int *out, const double *number, {type} *kept)"
)


class Kernel:
    """A CasADi function in C: `void <name>(const T *const *arg, T *const *res)`, T a double or a vector.

    Arguments and results may not overlap.

    Args:
        function: of SX, straight lines only; of sparse arguments and results the nonzeros are taken and given.
        lanes: whether T is a vector, and the name `<name>_lanes`: several segments at once.

    Attributes:
        formulas: C that is the same for all models with the same formulas, in texts that may be compiled apart.
        call: C of the function itself, which hands its places and numbers to the formulas.
        declared: the line that declares it.

    Raises:
        ValueError: an instruction that has no form in C here.
    """

    def __init__(self, function: ca.Function, lanes: bool = False) -> None:
        self._name, self._type = (f"{function.name()}_lanes", "vector") if lanes else (function.name(), "double")
        self._prefix = "lanes_" if lanes else ""
        self._values: list[tuple[int, tuple[int, ...], tuple[int, int] | float | None]] = []  # operation, of which values, place or number
        self._in: dict[tuple[int, int], int] = {}  # arguments that are read, in their order
        self._out: list[tuple[int, int]] = []  # results
        self._zero: list[tuple[int, int]] = []  # results that are always 0
        self._numbers: list[float] = []
        self._room = 1  # values that are handed on at once
        self._read(function)
        pieces = list(self._pieces())
        self.formulas = ["\n".join(pieces[first : first + PIECES]) for first in range(0, len(pieces), PIECES)]
        self.declared = f"CALL void {self._name}(const {self._type} *const *arg, {self._type} *const *res)"
        self.call = self._call(len(pieces))

    def _read(self, f: ca.Function) -> None:
        """Note the instructions, each with a value of its own."""
        at: dict[int, int] = {}
        for k in range(f.n_instructions()):
            op, of, to = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
            if op == ca.OP_OUTPUT:
                source = self._values[at[of[0]]]
                if source[0] == ca.OP_CONST and source[2] == 0:
                    self._zero.append((to[0], to[1]))
                    continue
                self._out.append((to[0], to[1]))
                self._values.append((op, (at[of[0]],), (to[0], len(self._out) - 1)))
                continue
            if op == ca.OP_INPUT:
                what: tuple[int, int] | float | None = (of[0], of[1])
            elif op == ca.OP_CONST:
                what = f.instruction_constant(k)
            elif op in _OPERATORS or op in _LOGIC or op in _FUNCTIONS:
                what = None
            else:
                raise ValueError(f"{f.name()}: no C for instruction {op} of CasADi {ca.CasadiMeta.version()}")
            self._values.append((op, tuple(at[j] for j in of) if what is None else (), what))
            at[to[0]] = len(self._values) - 1

    def _pieces(self) -> Iterator[str]:
        """C of one piece after the other."""
        last = {j: k for k, (_, of, _) in enumerate(self._values) for j in of}
        cuts = range(0, len(self._values), PIECE)
        kept: dict[int, int] = {}  # place in the array of a value that later pieces need
        free: list[int] = []
        for number, first in enumerate(cuts):
            there: set[int] = set()
            lines: list[str] = []
            free += [kept[j] for j in kept if first - PIECE <= last[j] < first]  # read for the last time in the piece before
            for k, (op, of, what) in enumerate(self._values[first : first + PIECE], first):
                if op in (ca.OP_INPUT, ca.OP_CONST):
                    continue
                lines += [self._load(j, kept) for j in dict.fromkeys(of) if j not in there]
                there.update(of)
                if op == ca.OP_OUTPUT:
                    assert isinstance(what, tuple)
                    lines.append(f"res[{what[0]}][out[{what[1]}]] = a{of[0]};")
                    continue
                there.add(k)
                lines.append(f"{self._type} a{k} = {self._form(op).format(*(f'a{j}' for j in of))};")
                if last.get(k, k) >= first + PIECE:
                    if not free:
                        free.append(self._room)
                        self._room += 1
                    kept[k] = free.pop()
                    lines.append(f"kept[{kept[k]}] = a{k};")
            yield "\n".join((f"{self._head(number)} {{", *lines, "}"))

    def _head(self, number: int) -> str:
        return _HEAD.format(name=f"{self._name}_{number}", type=self._type)

    def _load(self, j: int, kept: dict[int, int]) -> str:
        """C that brings a value into a piece that has not made it."""
        what = self._values[j][2]
        broadcast = "(vector){0} + " if self._prefix else ""
        if isinstance(what, tuple):
            slot = self._in.setdefault(what, len(self._in))
            return f"{self._type} a{j} = arg[{what[0]}][in[{slot}]];"
        if what is None:
            return f"{self._type} a{j} = kept[{kept[j]}];"
        if abs(what) <= SMALL and 8 * what % 1 == 0:
            return f"{self._type} a{j} = {broadcast}{what!r};"
        self._numbers.append(what)
        return f"{self._type} a{j} = {broadcast}number[{len(self._numbers) - 1}];"

    def _form(self, op: int) -> str:
        if op in _OPERATORS:
            return _OPERATORS[op]
        name = f"{self._prefix or 'one_'}{_LOGIC[op]}" if op in _LOGIC else f"{self._prefix}{_FUNCTIONS[op]}"
        return f"{name}({{0}}, {{1}})" if op in _OF_TWO_VALUES else f"{name}({{0}})"

    def _call(self, pieces: int) -> str:
        tables = {"in": self._in, "out": self._out} | ({"zero": self._zero} if self._zero else {})
        lines = [*(f"{self._head(number)};" for number in range(pieces)), f"{self.declared} {{"]
        lines += [f"  static const int {name}[] = {{{_c_list(place for _, place in places)}}};" for name, places in tables.items()]
        lines.append(f"  static const double number[] = {{{_c_list(self._numbers)}}};\n  {self._type} kept[{self._room}];")
        first = 0
        for result, places in groupby(self._zero, lambda place: place[0]):
            last = first + len(list(places))
            lines.append(f"  for (int k = {first}; k < {last}; k++) res[{result}][zero[k]] = ({self._type}){{0}};")
            first = last
        lines += [f"  {self._name}_{number}(arg, res, in, out, number, kept);" for number in range(pieces)]
        return "\n".join((*lines, "}"))


_OF_TWO_VALUES = {
    *(ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO, ca.OP_CONSTPOW),
    *(op for op, name in _FUNCTIONS.items() if name in _OF_TWO),
}


def _c_list(values: Iterable[float]) -> str:
    """Values as C has them; of these, repr has inf and nan in other words."""
    return ", ".join(map(repr, values)).replace("inf", "INFINITY").replace("nan", "NAN") or "0"
