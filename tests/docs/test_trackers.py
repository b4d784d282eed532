"""Examples on the page about trackers are links that the package reads."""

from __future__ import annotations

import re
import tomllib

import pytest

from tepm_opt.hw.trackers import find_tracker
from tepm_opt.models.hardware import TrackerLink
from tests.docs.texts import ROOT

TEXT = (ROOT / "docs" / "how-to" / "trackers.md").read_text(encoding="utf-8")
EXAMPLES = [
    block for block in re.findall(r"^```toml\n(.*?)^```", TEXT, re.S | re.M) if re.search(r"^\[hardware\.tracker\]", block, re.M)
]  # fmt: skip


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_is_a_valid_link(example: str) -> None:
    link = TrackerLink.model_validate(tomllib.loads(example)["hardware"]["tracker"])
    kind = find_tracker(link.kind)
    assert set(kind.read_options(link).model_dump()) >= set(link.options)
    assert len(link.devices) == 4


def test_every_section_has_an_example_of_its_kind() -> None:
    """Its title names the kind in brackets."""
    for section in re.split(r"^## ", TEXT, flags=re.M)[1:]:
        if named := re.match(r".*\((\w+)\)\n", section):
            assert f'kind = "{named[1]}"' in section, named[0]
    assert {tomllib.loads(example)["hardware"]["tracker"]["kind"] for example in EXAMPLES} >= {"motioncapture", "natnet"}
