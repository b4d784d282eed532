"""Generated C: kernels and the loops around them become a shared library, kept under the hash of all it depends on."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources

import casadi as ca

from tepm_opt.models.backends import compiler

FLAGS = (
    *("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math"),
    "-freciprocal-math",  # edges are divided by their lengths, component by component
    "-fno-semantic-interposition",  # calls within the library are calls, or nothing, and no look-ups
)
KERNEL_FLAGS = ("-O1", "-fira-region=one", "-fira-algorithm=priority", *FLAGS[1:])
"""Flags of kernels. They are straight lines: -O3 finds nothing in them to make faster, and takes three times as long."""


@dataclass(frozen=True)
class Unit:
    """What is compiled together: kernels, sizes and index arrays, and the loops around them.

    Attributes:
        kernels: CasADi functions; of one with a sparse result the C text also gets `<name>_nnz`, `<name>_row` and `<name>_col`.
        sizes: macros by name; LANES is the number of doubles in a vector.
        arrays: static arrays of integers by name.
        loops: names of the C files in this package, one after the other.
        symbols: functions that are called from outside.
        lanes: kernels that also come as `<name>_lanes`, which takes and returns vectors: several segments at once.
        stem: with which the name of the library begins.
    """

    kernels: Mapping[str, ca.Function]
    sizes: Mapping[str, float]
    arrays: Mapping[str, Sequence[int]]
    loops: tuple[str, ...]
    symbols: tuple[str, ...]
    lanes: tuple[str, ...] = ()
    stem: str = "time_stepping"

    @cached_property
    def source(self) -> str:
        """The C text of all together, in one file."""
        return "\n".join(
            (_kernels_of(*self.kernels.values()), self._head, *(f"static {self._lanes_of(name)}" for name in self.lanes), *self._loops)
        )

    @cached_property
    def parts(self) -> dict[str, str]:
        """The same as texts that are compiled apart: one of each kernel by its name, and one of the loops, `LOOPS`."""
        found, declared = {}, []
        for name, function in self.kernels.items():
            pieces = _pieces(function, int(self.sizes["NU"]) // 2) if name not in self.lanes else []
            for piece, _ in pieces:
                found[piece.name()] = "\n".join((_HIDDEN, _kernels_of(piece)))
            declared += [_DECLARED.format(name=name), *(_DECLARED.format(name=piece.name()) for piece, _ in pieces)]
            if pieces:
                declared.append(_joined_text(function, pieces))
                continue
            more = (self._vectors, self._lanes_of(name)) if name in self.lanes else ()
            found[name] = "\n".join((_HIDDEN, _kernels_of(function), *more))
        declared += [_DECLARED_LANES.format(name=name) for name in self.lanes]
        found[LOOPS] = "\n".join((_kernels_of(), _HIDDEN, self._head, *declared, *self._loops))
        return found

    @cached_property
    def _vectors(self) -> str:
        each = "\n".join(f"ONE_BY_ONE({name})" for name in _ONE_BY_ONE)
        return f"#define LANES {self.sizes['LANES']}\n{_VECTORS}\n{each}"

    @cached_property
    def _head(self) -> str:
        """Sizes, index arrays, and the arithmetic of vectors."""
        work = {"SZ_W": max(f.sz_w() for f in self.kernels.values()), "SZ_IW": max(f.sz_iw() for f in self.kernels.values())}
        sizes: dict[str, float] = {**self.sizes, **work}
        arrays = dict(self.arrays)
        for name, function in self.kernels.items():
            if name.endswith("_by"):
                pattern = function.sparsity_out(0)
                sizes[f"{name}_nnz"] = pattern.nnz()
                arrays |= {f"{name}_row": pattern.row(), f"{name}_col": pattern.get_col()}
        lines = [f"#define {name} {value}" for name, value in sizes.items() if name != "LANES"]
        lines += [f"static const int {name}[] = {{{', '.join(map(str, values)) or '0'}}};" for name, values in arrays.items()]
        return "\n".join((self._vectors, *lines))

    @cached_property
    def _loops(self) -> list[str]:
        return [(resources.files("tepm_opt.models.backends") / name).read_text(encoding="utf-8") for name in self.loops]

    def _lanes_of(self, name: str) -> str:
        return _in_lanes(_kernels_of(self.kernels[name]), name, self.kernels[name])


LONGEST = 8000
"""Operations above which a Jacobian is compiled in pieces."""
LOOPS = "loops"
"""Name of the part that has no kernel."""
_HIDDEN = '#define CASADI_SYMBOL_EXPORT __attribute__((visibility("hidden")))'
_DECLARED = "int {name}(const casadi_real **, casadi_real **, casadi_int *, casadi_real *, int);"
_DECLARED_WITH_NAMES = "int {name}(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int mem)"
_DECLARED_LANES = "void {name}_lanes(const vector *const *arg, vector *const *res);"


def _pieces(function: ca.Function, actuators: int) -> list[tuple[ca.Function, list[int]]]:
    """A long Jacobian as one function for each actuator, with the numbers of its nonzeros; none for others.

    A compiler needs four times as long for twice as long a text. A row, of one actuator, depends on few of the operations, so that all
    pieces together are hardly longer.
    """
    if function.n_out() != 1 or function.n_instructions() <= LONGEST:
        return []
    arguments = [ca.SX.sym(function.name_in(k), function.size1_in(k)) for k in range(function.n_in())]
    values, rows = ca.SX(function(*arguments)).nz[:], function.sparsity_out(0).row()
    found = []
    for actuator in range(actuators):
        numbers = [number for number, row in enumerate(rows) if row % actuators == actuator]
        found.append((ca.Function(f"{function.name()}_{actuator}", arguments, [ca.cse(values[numbers])]), numbers))
    return found


def _joined_text(function: ca.Function, pieces: Sequence[tuple[ca.Function, Sequence[int]]]) -> str:
    """C of a function that calls its pieces."""
    calls = []
    for piece, numbers in pieces:
        count, listed = len(numbers), ", ".join(map(str, numbers)) or "0"
        calls += [f"  {{ static const int at[] = {{{listed}}}; double got[{count + 1}], *result[] = {{got}};"]
        calls += [f"    {piece.name()}(arg, result, iw, w, mem); for (int i = 0; i < {count}; i++) res[0][at[i]] = got[i]; }}"]
    head = _DECLARED_WITH_NAMES.format(name=function.name())
    return "\n".join((f"{head} {{", *calls, "  return 0;\n}"))


def _kernels_of(*functions: ca.Function) -> str:
    """CasADi's C of functions, of which no argument and no result is ever left out."""
    prefix = f"of_{functions[0].name()}" if len(functions) == 1 else "kernels"  # its helpers have their own names in each text
    generator = ca.CodeGenerator(prefix, {"casadi_int": "int", "with_header": False})
    for function in functions:
        generator.add(function)
    return _WRITTEN.sub("", _READ.sub(r"arg[\1][\2]", generator.dump()))


_READ = re.compile(r"arg\[(\d+)\]\? arg\[\1\]\[(\d+)\] : 0")
_WRITTEN = re.compile(r"if \(res\[\d+\]!=0\) ")
_VECTORS = """
typedef double vector __attribute__((vector_size(8 * LANES), aligned(8))); /* anywhere in arrays of doubles */
static inline vector lanes_sq(vector x) { return x * x; }
static inline vector lanes_sqrt(vector x) { for (int i = 0; i < LANES; i++) x[i] = sqrt(x[i]); return x; }
static inline vector lanes_sign(vector x) { for (int i = 0; i < LANES; i++) x[i] = x[i] < 0 ? -1 : x[i] > 0 ? 1 : x[i]; return x; }
typedef long long lanes_mask __attribute__((vector_size(8 * LANES), aligned(8)));
static inline vector lanes_where(lanes_mask m, vector x) { return (vector)(m & (lanes_mask)x); } /* 0 elsewhere */
static inline vector lanes_one(lanes_mask m) { return lanes_where(m, (vector){0} + 1); }
static inline vector lanes_less(vector x, vector y) { return lanes_one((lanes_mask)(x < y)); }
static inline vector lanes_most(vector x, vector y) { return lanes_one((lanes_mask)(x <= y)); }
static inline vector lanes_same(vector x, vector y) { return lanes_one((lanes_mask)(x == y)); }
static inline vector lanes_other(vector x, vector y) { return lanes_one((lanes_mask)(x != y)); }
static inline vector lanes_and(vector x, vector y) { return lanes_one((lanes_mask)(x != 0) & (lanes_mask)(y != 0)); }
static inline vector lanes_or(vector x, vector y) { return lanes_one((lanes_mask)(x != 0) | (lanes_mask)(y != 0)); }
static inline vector lanes_not(vector x) { return lanes_one((lanes_mask)(x == 0)); }
static inline vector lanes_if(vector x, vector y) { return lanes_where((lanes_mask)(x != 0), y); }
static inline vector lanes_fmin(vector x, vector y) { for (int i = 0; i < LANES; i++) x[i] = fmin(x[i], y[i]); return x; }
static inline vector lanes_fmax(vector x, vector y) { for (int i = 0; i < LANES; i++) x[i] = fmax(x[i], y[i]); return x; }
#define ONE_BY_ONE(f) static inline vector lanes_##f(vector x) { for (int i = 0; i < LANES; i++) x[i] = f(x[i]); return x; }
"""
_ONE_BY_ONE = ("fabs", "exp", "expm1", "log", "log1p", "tanh", "sin", "cos", "tan", "asin", "acos", "atan")
_ALONE = "|".join(("sq", "sqrt", "sign", "fmin", "fmax", *_ONE_BY_ONE))
_OPERATORS = {"<": "less", "<=": "most", "==": "same", "!=": "other", "&&": "and", "||": "or"}


_LOOP = """void {name}_lanes(const vector *const *arg, vector *const *res) {{
  static const int in[] = {{{inputs}}}, out[] = {{{outputs}}};
  enum {{ N_IN = sizeof in / sizeof *in, N_OUT = sizeof out / sizeof *out }};
  static _Thread_local double given[{given}], got[{got}], work[{work}]; /* as large as the model */
  double *result[N_OUT], *at;
  const double *argument[N_IN];
  static _Thread_local casadi_int integers[{integers}];
  for (int lane = 0; lane < LANES; lane++) {{
    at = given;
    for (int i = 0; i < N_IN; i++) {{ argument[i] = at; for (int k = 0; k < in[i]; k++) *at++ = arg[i][k][lane]; }}
    at = got;
    for (int i = 0; i < N_OUT; i++) {{ result[i] = at; at += out[i]; }}
    {name}(argument, result, integers, work, 0);
    for (int i = 0; i < N_OUT; i++) for (int k = 0; k < out[i]; k++) res[i][k][lane] = result[i][k];
  }}
}}
"""


def _in_lanes(text: str, name: str, function: ca.Function) -> str:
    """A kernel on vectors: CasADi's straight-line code with another type, or a loop over lanes where it is not mere arithmetic."""
    inner = re.search(rf"int {name}\(.*?\)\s*\{{\s*return (\w+)\(", text, re.S)
    body = inner and re.search(rf"static int {inner[1]}\([^{{]*\{{\n(.*?)\n\}}", text, re.S)
    if body:
        code = body[1].replace("casadi_real", "vector").replace("return 0;", "")
        code = re.sub(r"=(-?[\d.]+(?:e[-+]?\d+)?);", r"=(vector){0}+\1;", code)
        code = re.sub(rf"\b(?:casadi_)?({_ALONE})\(", r"lanes_\1(", code)
        code = re.sub(r"\((\w+)(<=?|==|!=|&&|\|\|)(\w+)\)", lambda m: f"lanes_{_OPERATORS[m[2]]}({m[1]},{m[3]})", code)
        code = re.sub(r"\((\w+)\?(\w+):0\)", r"lanes_if(\1,\2)", code)
        code = re.sub(r"\(!(\w+)\)", r"lanes_not(\1)", code)
        if not re.search(r"[?<>!&|]|\b(?!lanes_)[A-Za-z_]\w*\(", code):
            return f"void {name}_lanes(const vector *const *arg, vector *const *res) {{\n{code}\n}}"
    sizes = [function.nnz_in(k) for k in range(function.n_in())], [function.nnz_out(k) for k in range(function.n_out())]
    inputs, outputs = (", ".join(map(str, part)) for part in sizes)
    return _LOOP.format(
        name=name,
        inputs=inputs,
        outputs=outputs,
        given=max(sum(sizes[0]), 1),
        got=max(sum(sizes[1]), 1),
        work=function.sz_w() + 1,
        integers=function.sz_iw() + 1,
    )


def build(unit: Unit) -> ctypes.CDLL | None:
    """The library of a unit, kept or compiled; None (and one warning) where that is not possible."""
    instead = "CasADi's virtual machine is used, with the same results, some 50 times slower"
    parts = [compiler.Part(name, text, FLAGS if name == LOOPS else KERNEL_FLAGS) for name, text in unit.parts.items()]
    return compiler.build(parts, unit.stem, unit.symbols, instead)
