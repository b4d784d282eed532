"""The command line `tepm`: parses options, calls the library, prints and draws; computes nothing itself.

Exit status: 0 all points solved, 1 some not, 2 wrong input, 130 interrupted (what was solved is kept).

Here nothing is imported but what starts at once: what takes longer can be interrupted (Ctrl-C) like any work.
"""

from __future__ import annotations

import codecs
import io
import os
import sys
from collections.abc import Sequence

INTERRUPTED = 130
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its status; what a person got wrong is one line on the error stream.

    Linear algebra runs on one thread: threads that share matrices of this size wait for each other, badly so on a busy machine.
    """
    for name in THREADS:  # read when the libraries are loaded
        os.environ.setdefault(name, "1")
    sys.exit(run(list(sys.argv[1:] if arguments is None else arguments)))


SPELT = {
    "°": " deg", "±": "+-", "…": "...", "–": "-", "—": "-", "−": "-", "·": "*", "×": "x", "²": "^2", "³": "^3", "→": "->", "≤": "<=",
    "≥": ">=", "≈": "~", "µ": "u", "μ": "u", "λ": "lambda", "σ": "sigma", "Δ": "Delta", "θ": "theta", "Ω": "Ohm", "½": "1/2", "√": "sqrt",
    "✓": "ok", "✗": "x", "’": "'",
}  # fmt: skip
"""Characters that not every terminal knows, in those that all do."""


def spelt(error: UnicodeError) -> tuple[str | bytes, int]:
    """Replace characters that a stream cannot encode by ones that it can; a handler of encoding errors.

    Raises:
        UnicodeError: of decoding.
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(SPELT.get(character, "?") for character in error.object[error.start : error.end]), error.end


def run(arguments: list[str]) -> int:
    """Exit status of the command line with these arguments; what a terminal cannot show is spelt."""
    codecs.register_error("spelt", spelt)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="spelt")
    try:
        from tepm_opt.cli.program import execute

        return execute(arguments)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
