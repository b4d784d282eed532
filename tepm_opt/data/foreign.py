"""Files of other programs where one of ours belongs: named as what they are, with the way to ours."""

from __future__ import annotations

import re
from pathlib import Path

from tepm_opt.errors import InputError

LOOKED_AT = 4096
"""Bytes of a file by which its kind is known."""
BYTES = (
    (b"\xd0\xcf\x11\xe0", "an Excel workbook (.xls) or another old Office file"),
    (b"\x89HDF", "an HDF5 file"),
    (b"PAR1", "a Parquet file"),
    (b"MATLAB 5.0", "a MAT file"),
    (b"%PDF", "a PDF"),
    (b"SQLite format 3", "an SQLite database"),
    (b"\x89MCAP", "an MCAP recording"),
    (b"\x1f\x8b", "a gzip archive"),
)
"""First bytes of files by their kind."""
ROOTS = {"mujoco": "an MJCF model of MuJoCo", "robot": "a URDF model", "sdf": "an SDF model of Gazebo", "html": "a web page"}
"""Root elements of XML."""
CSV = "tepm reads CSV here: open it in its program and save it as CSV"
TOML = "tepm reads TOML here"


def kind_of(begin: bytes) -> str:
    """Name of a file's kind by its first bytes; empty where it is none of the kinds that people bring by mistake."""
    if begin.startswith(b"PK\x03\x04"):
        return "an Excel workbook" if b"xl/" in begin or b"[Content_Types].xml" in begin else "a zip archive"
    if found := next((kind for mark, kind in BYTES if begin.startswith(mark)), ""):
        return found
    text = begin.decode("utf-8-sig", errors="ignore").lstrip()
    if not text.startswith("<"):
        return "a JSON file" if re.match(r'\{\s*("|\})', text) else ""
    root = re.search(r"<([A-Za-z][\w.-]*)", re.sub(r"<!--.*?-->|<\?.*?\?>|<!\w[^>]*>", "", text, flags=re.DOTALL))
    return ROOTS.get(root[1].lower(), "an XML file") if root else "an XML file"


def refuse_foreign(path: str | Path, way: str) -> None:
    """Refuse a file of another program; what cannot be read is left to whoever reads it.

    Args:
        path: of the file.
        way: what is read instead, and how a person gets there.

    Raises:
        InputError: it is of another kind; the message names that.
    """
    try:
        with Path(path).open("rb") as file:
            kind = kind_of(file.read(LOOKED_AT))
    except OSError:
        return
    if kind:
        raise InputError(f"{path} is {kind}; {way}")
