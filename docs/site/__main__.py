"""`python -m docs.site OUT`: build the site into a folder; a warning is an error."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from sphinx.cmd.build import build_main

from docs.site import pages


def build(out: Path) -> int:
    """Build the site into a folder: Sphinx's exit status, 0 without a warning."""
    with tempfile.TemporaryDirectory() as staged:
        pages.write(Path(staged) / "pages")
        options = ["-W", "--keep-going", "-q", "-c", str(Path(__file__).parent), "-d", f"{staged}/doctrees"]
        return build_main([*options, f"{staged}/pages", str(out)])


if __name__ == "__main__":
    sys.exit(build(Path(sys.argv[1] if len(sys.argv) > 1 else "site")))
