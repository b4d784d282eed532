"""The maps of docs/how-to/importing.md are maps; the guide names every key there is."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from tepm_opt.data.importing.maps import Format, ImportMap, Quantity, TimeMap, resolve_entries
from tepm_opt.data.importing.units import UNITS
from tests.data.made import CHANNELS, NAMES

PAGE = (Path(__file__).parents[3] / "docs" / "how-to" / "importing.md").read_text(encoding="utf-8")
MAPS = re.findall(r"```toml\n(.*?)```", PAGE, re.S)


@pytest.mark.parametrize("text", MAPS, ids=range(len(MAPS)))
def test_maps(text: str) -> None:
    assert len(text.splitlines()) <= 15
    given = ImportMap.model_validate(tomllib.loads(text))
    filled = [target for each in resolve_entries(given, CHANNELS if given.robot else None, "map.toml") for target in each.targets]
    assert set(filled) <= {*NAMES.columns, "force", "encoder"}
    assert len(filled) > 1


def test_every_key_is_described() -> None:
    keys = [*ImportMap.model_fields, *Quantity.model_fields, *TimeMap.model_fields, *Format.model_fields]
    assert [key for key in keys if not re.search(rf"`{key}\b|^{key}\b", PAGE, re.M)] == []
    assert [unit for kind in ("pressure", "force") for unit in UNITS[kind] if unit not in PAGE] == []
