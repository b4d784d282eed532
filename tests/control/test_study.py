"""What the controllers reach on the virtual prototype with ten seeds each; about an hour on two cores."""

from __future__ import annotations

import numpy as np
import pytest

from tests.control import study

pytestmark = pytest.mark.study

PUBLISHED = {"mode1": 9.77, "mode2": 5.60}  # mm, Fig. 12
CASES = {
    "points": ("mpc", "mode1", "mode2"),
    "circle": ("mpc", "mode2"),
    "lissajous": ("mpc", "mode2"),
    "weak circle": ("mpc", "mode2"),
}


def means(task: str, controllers: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Mean figures of the seeds by controller."""
    done = study.everything((task, name, seed) for name in controllers for seed in study.SEEDS)
    found = {}
    for name in controllers:
        rows = [result for job, result in done.items() if job[1] == name]
        found[name] = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
    print(task, found)
    return found


def test_point_by_point() -> None:
    """Fig. 12: modes 1 and 2 near what the paper has, the predictive controller far better in the same run."""
    found = means("points", CASES["points"])
    for mode, published in PUBLISHED.items():
        assert found[mode]["true"] == pytest.approx(published, rel=0.15)
    assert found["mpc"]["true"] <= 1.5
    assert found["mpc"]["true"] <= 0.27 * found["mode2"]["true"]
    assert found["mpc"]["fallbacks"] == 0


@pytest.mark.parametrize("task", ["circle", "lissajous", "weak circle"])
def test_moving(task: str) -> None:
    """Circle in 8 s and lissajous in 6 s; the circle with a muscle that is 20 % weaker."""
    found = means(task, CASES[task])
    assert found["mpc"]["true"] <= 3.0
    assert found["mpc"]["true"] <= 0.25 * found["mode2"]["true"]


def test_bench() -> None:
    """Fig. 6's set points on the bench; published for mode 2 are 0.8 … 0.9 mm and 0.9 … 1.0 mm."""
    done = list(study.everything(("bench", "", seed) for seed in study.SEEDS).values())
    found = {key: float(np.mean([row[key] for row in done])) for key in done[0]}
    print(found)
    assert max(found.values()) <= 0.3


@pytest.mark.parametrize("what", study.DISTURBANCES)
def test_disturbed(what: str) -> None:
    """Held within 2 mm from 3 s after the change on (4 mm without a sensor), at every moment and within all limits."""
    done = list(study.everything(("disturbed", what, seed) for seed in study.SEEDS).values())
    print(what, {key: [round(row[key], 2) for row in done] for key in done[0]})
    assert all(row["inside"] == 1 for row in done)
    assert max(row["worst"] for row in done) < 31  # 0.1 N sideways moves the tip by that much without control
    assert max(row["after"] for row in done) <= (4.0 if what.startswith("dead") else 2.0)


def test_every_piece_earns_its_place() -> None:
    """The split: fewer moves of the regulators than without knowing their grid, tensions about the middle, and what is lost without."""
    found = means("circle", tuple(study.ABLATIONS))
    whole = found["all"]
    assert whole["moves"] <= found["resolution ignored"]["moves"] / 3
    assert whole["tension"] == pytest.approx(3.5, rel=0.15)
    assert whole["true"] < 0.5 * found["tension only"]["true"]
    assert whole["true"] < 0.5 * found["pressure only"]["true"]
    quick = means("lissajous", ("all", "no mid-ranging"))
    assert quick["all"]["true"] < 0.95 * quick["no mid-ranging"]["true"]
