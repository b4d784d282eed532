"""Names of version 0.2 that work until version 0.4: commands that say what they are now, names of the package with a warning."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import pytest

import tepm_opt
from tepm_opt import studies
from tepm_opt.cli.program import OLD_NAMES, PANELS, app
from tests.cli.conftest import Command

LISTED = [name for names in PANELS.values() for name in names]


def test_at_most_twenty_commands_and_each_in_a_panel(tepm: Command) -> None:
    shown = [str(each.name) for each in (*app.registered_commands, *app.registered_groups) if not each.hidden]
    assert sorted(shown) == sorted(LISTED)
    assert len(LISTED) <= 20
    text = tepm("--help").out
    places = [text.index(f" {name} ", text.index(f" {panel} ")) for panel, names in PANELS.items() for name in names]
    assert places == sorted(places), "the help lists them in the order of work"
    assert [name for name in OLD_NAMES if f"│ {name} " in text] == []


@pytest.mark.parametrize("old", OLD_NAMES)
def test_an_old_command_is_the_new_one(tepm: Command, old: str) -> None:
    new = OLD_NAMES[old]
    told, expected = tepm(old, "--help"), tepm(*new.split(), "--help")
    assert told.err == f"`tepm {old}` is now `tepm {new}`; the old name goes with version 0.4\n"
    assert (told.status, expected.err) == (0, "")
    usage, wanted = (text.partition("[OPTIONS]")[2].split() for text in (told.out, expected.out))
    assert usage == wanted


def test_status_and_json_of_an_old_command_are_unchanged(tepm: Command, here: Path) -> None:
    shown = tepm("rig", "show", "--json")
    assert (shown.status, json.loads(shown.out)) == (0, tepm("hw", "rig", "show", "--json").json())
    assert tepm("next", "nowhere").status == 2
    assert tepm("rig", "oops").status == 2


def test_an_old_name_of_the_package_is_the_new_one() -> None:
    for old, new in tepm_opt.RENAMED.items():
        with pytest.warns(DeprecationWarning, match=rf"tepm_opt\.{old} is now tepm_opt\.{new}; the old name goes with version 0\.4"):
            found = getattr(tepm_opt, old)
        home, _, name = new.rpartition(".")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert found is getattr(studies if home else tepm_opt, name)
        assert old not in dir(tepm_opt)
