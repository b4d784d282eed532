"""Data sets by an independent simulator: the hidden effect is named, the gap closes."""

from __future__ import annotations

import json
from statistics import median

import pytest

from tests.discrepancy.study import Answer, examine
from tests.paths import SHARED

BLIND = SHARED / "blind"
SETS = [f"set_{number:02d}" for number in range(1, 14)]
SIZED = ["set_01", "set_04", "set_05", "set_06", "set_07", "set_08", "set_10", "set_11"]
"""Those whose sizes mean the same in the model as in the simulator."""

pytestmark = [pytest.mark.study, pytest.mark.skipif(not BLIND.is_dir(), reason=f"blind data {BLIND} are not on this machine")]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Answer]:
    """The answer to every set."""
    every = {}
    for name in SETS:
        label = json.loads((BLIND / "labels" / f"{name}.json").read_text(encoding="utf-8"))
        every[name] = examine(BLIND / name, label, tmp_path_factory.mktemp(name))
    return every


@pytest.mark.parametrize("name", SETS)
def test_names_what_is_hidden(found: dict[str, Answer], name: str) -> None:
    assert found[name].right, found[name].line(name)


@pytest.mark.parametrize("name", SIZED)
def test_recovers_the_size(found: dict[str, Answer], name: str) -> None:
    answer = found[name]
    assert answer.sizes
    assert answer.recovered == dict.fromkeys(answer.sizes, True), answer.line(name)


def test_the_gap_closes(found: dict[str, Answer]) -> None:
    known = {name: answer for name, answer in found.items() if not answer.foreign}
    closed = {name: answer.verdict.errors.gap_closed_fraction for name, answer in known.items()}
    assert median(closed.values()) >= 0.9, closed
    assert min(closed.values()) >= 0.75, closed


def test_what_is_left_is_near_the_noise(found: dict[str, Answer]) -> None:
    left = [a.verdict.errors.corrected / a.verdict.errors.noise_floor for a in found.values() if not a.foreign]
    assert median(left) <= 1.5, left


def test_nothing_is_named_in_vain(found: dict[str, Answer]) -> None:
    """What is outside the vocabulary is left unexplained; a sound machine is called sound."""
    for name, answer in found.items():
        if answer.foreign or not answer.truth:
            assert not answer.named, answer.line(name)


def test_every_set_is_here() -> None:
    assert sorted(path.stem for path in BLIND.glob("labels/*.json")) == SETS
