"""Slips of the pen: every place in a source where one is possible. C++ is read by its layout, Python by its syntax tree."""

from __future__ import annotations

import ast
import random
import re
from collections.abc import Iterator

from tests.hw.spoil.spoiling import Spoiling

BINARY = {
    "comparison turned": {"<": ">", ">": "<", "<=": ">=", ">=": "<=", "==": "!=", "!=": "==", "is": "is not", "is not": "is"},
    "boundary moved": {"<": "<=", ">": ">=", "<=": "<", ">=": ">"},
    "and for or": {"&&": "||", "||": "&&", "and": "or", "or": "and"},
    "plus for minus": {"+": "-", "-": "+", "+=": "-=", "-=": "+="},
    "times for divided by": {"*": "/", "/": "*", "%": "*", "//": "*"},
    "bits": {"&": "|", "|": "&", "^": "&", "<<": ">>", ">>": "<<", "|=": "&=", "&=": "|=", "^=": "|="},
}
"""What stands between two values, and what stands there by mistake."""

Change = tuple[str, int, int, str]
"""An operator's name, the characters it replaces, and by what."""


def changes(file: str, text: str) -> list[Spoiling]:
    """All slips that are possible in a file."""
    found = _python(text) if file.endswith(".py") else _cpp(text)
    return [Spoiling(file, *change) for change in sorted(set(found), key=lambda change: (change[1:], change[0]))]


def shuffled(file: str, text: str, seed: int) -> list[Spoiling]:
    """All slips that are possible in a file in an order that the seed draws: kind after kind, so that the rare ones come early, too."""
    kinds: dict[str, list[Spoiling]] = {}
    for spoiling in changes(file, text):
        kinds.setdefault(spoiling.name, []).append(spoiling)
    draw = random.Random(f"{seed} {file}")
    rows = [draw.sample(kinds[name], len(kinds[name])) for name in sorted(kinds)]
    draw.shuffle(rows)
    return [row[k] for k in range(max(map(len, rows), default=0)) for row in rows if k < len(row)]


# ---------------------------------------------------------------- C++

_DARK = re.compile(
    r"""//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])'|^[ \t]*\#(?:[^\n\\]|\\.)*|\b(?:static_assert|__asm__)\b[^;]*;""",
    re.S | re.M | re.X,
)
"""Comments, strings, lines of the preprocessor, assertions of the compiler."""
_BETWEEN = re.compile(r"(?<= )(?:[<>=!]=|[<>]{1,2}|&&|\|\||[&|^+\-]=?|[*/])(?= )")
_NUMBER = re.compile(r"(?<![\w.])(0x[0-9A-Fa-f]+|\d+\.\d+|\d+)(?=[uUlLfF]*(?![\w.]))")
_STATEMENT = re.compile(r"^( +)([^\s{}][^\n{}]*;)[ ]*$", re.M)
_DECLARATION = re.compile(r"(const|constexpr|static|using|volatile|extern|return)\b|[\w:]+(<[^;]*>)?[ *&]+\w+( =|;|\[|,| __)")


def dark(text: str) -> str:
    """The C++ text with blanks for what the compiler does not turn into instructions."""
    return _DARK.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), text)


def _cpp(text: str) -> Iterator[Change]:
    plain = dark(text)
    for found in _BETWEEN.finditer(plain):
        yield from ((name, *found.span(), table[found[0]]) for name, table in BINARY.items() if found[0] in table)
    for found in re.finditer(r"\+\+|--", plain):
        yield "plus for minus", *found.span(), {"++": "--", "--": "++"}[found[0]]
    for found in re.finditer(r"(?<=[ (])[!~](?=[\w(!])", plain):
        yield "not left out", *found.span(), ""
    for found in re.finditer(r"\b(?:if|while) \(", plain):
        start, end = found.end() - 1, _closing(plain, found.end())
        yield "condition negated", start, end, f"(!{text[start:end]})"
    for found in re.finditer(r"\b(?:true|false)\b", plain):
        yield "true for false", *found.span(), {"true": "false", "false": "true"}[found[0]]
    for found in _NUMBER.finditer(plain):
        yield "constant changed", *found.span(1), _other(found[1])
    yield from _statements(plain, text)


def _closing(text: str, at: int) -> int:
    """Where the bracket that was opened before `at` is closed."""
    depth = 1
    while depth:
        depth += {"(": 1, ")": -1}.get(text[at], 0)
        at += 1
    return at


def _other(number: str) -> str:
    """Another number: 0 for 1 and 1 for 0, else double."""
    if number.startswith("0x"):
        return hex(2 * int(number, 16) % 16 ** (len(number) - 2))
    if "." in number or "e" in number:
        return str(2 * float(number)) if float(number) else "1.0"
    return str({0: 1, 1: 0}.get(int(number), 2 * int(number)))


def _depend(first: str, second: str) -> bool:
    """Whether the order of two statements matters, as far as one can see: one sets what the other names, or both are calls."""
    targets = [re.match(r"(?:[+-]{2})?([\w.\[\]]+)(?= [^\w\s=]?=(?!=)|;|\[|$|[+-]{2})", each) for each in (first, second)]
    names = [
        target and re.search(rf"\b{re.escape(target[1].removeprefix('self.').partition('[')[0])}\b", other)
        for target, other in zip(targets, (second, first), strict=True)
    ]
    return any(names) or not any(targets)


def _statements(plain: str, text: str) -> Iterator[Change]:
    """A statement of one line is left out, or done after the one that follows it."""
    before: tuple[int, int, str] | None = None
    for found in _STATEMENT.finditer(plain):
        start, end = found.span(2)
        previous = plain[:start].rstrip()[-1:]
        following = plain[end:].lstrip()
        if _DECLARATION.match(found[2]) or previous not in ";{}:" or following.startswith("else"):
            before = None
            continue
        yield "statement left out", start, end, "{}"
        near = before and before[2] == found[1] and not text[before[1] : start].strip()
        if near and before and _depend(plain[before[0] : before[1]], plain[start:end]):
            yield "statements swapped", before[0], end, text[start:end] + text[before[1] : start] + text[before[0] : before[1]]
        before = start, end, found[1]


# ---------------------------------------------------------------- Python

_WORDS = ("__repr__", "describe", "header")
"""Functions that write what people read, or what a test compares with a file."""
_SIMPLE = (ast.Expr, ast.Assign, ast.AugAssign)


def _is_docstring(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _python(text: str) -> Iterator[Change]:
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def place(line: int, column: int) -> int:
        row = text[starts[line - 1] : starts[line]]
        return starts[line - 1] + len(row.encode()[:column].decode())

    def span(node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return place(node.lineno, node.col_offset), place(node.end_lineno, node.end_col_offset)

    def between(left: ast.expr, right: ast.expr) -> Iterator[Change]:
        start, end = span(left)[1], span(right)[0]
        if found := re.search(r"(?<=\s)(is not|not in|[^\s()]+)(?=\s)", text[start:end]):
            for name, table in BINARY.items():
                if found[0] in table:
                    yield name, start + found.start(), start + found.end(), table[found[0]]

    def inside(node: ast.AST) -> Iterator[Change]:
        if isinstance(node, ast.Compare):
            yield from between(node.left, node.comparators[0])
        elif isinstance(node, ast.BoolOp):
            yield from between(node.values[0], node.values[1])
        elif isinstance(node, ast.BinOp):
            yield from between(node.left, node.right)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            yield "not left out", span(node)[0], span(node.operand)[0], ""
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
            yield "true for false", *span(node), str(not node.value)
        elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            start, end = span(node)
            yield "constant changed", start, end, _other(text[start:end])
        if isinstance(node, ast.If | ast.While | ast.IfExp):
            start, end = span(node.test)
            yield "condition negated", start, end, f"(not ({text[start:end]}))"
        if isinstance(node, ast.FunctionDef | ast.If | ast.While | ast.For | ast.With | ast.Try | ast.ExceptHandler):
            yield from block(node.body)
            yield from block(getattr(node, "orelse", []))

    def block(body: list[ast.stmt]) -> Iterator[Change]:
        for k, node in enumerate(body):
            if _is_docstring(node):
                continue
            start, end = span(node)
            if isinstance(node, (*_SIMPLE, ast.Raise)):
                yield "statement left out", start, end, "pass" + "\n" * text[start:end].count("\n")
            before = body[k - 1]
            if not (k and isinstance(node, _SIMPLE) and isinstance(before, _SIMPLE)) or _is_docstring(before):
                continue
            first = span(before)
            if _depend(text[slice(*first)], text[start:end]):
                yield "statements swapped", first[0], end, text[start:end] + text[first[1] : start] + text[slice(*first)]

    def walk(node: ast.AST) -> Iterator[Change]:
        yield from inside(node)
        for name, value in ast.iter_fields(node):
            if name not in ("annotation", "returns", "decorator_list", "bases"):
                yield from (change for child in (value if isinstance(value, list) else [value]) for change in visit(child))

    def visit(node: object) -> Iterator[Change]:
        hidden = isinstance(node, ast.FunctionDef) and node.name in _WORDS
        main = isinstance(node, ast.If) and "__name__" in ast.unparse(node.test)
        if isinstance(node, ast.AST) and not (hidden or main or isinstance(node, ast.Raise | ast.JoinedStr)):
            yield from walk(node)

    return walk(ast.parse(text))
