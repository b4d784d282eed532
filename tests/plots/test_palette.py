"""Colours that mean one thing each, and that stay apart for those who do not see green, and without colour."""

from __future__ import annotations

import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import load_robot
from tepm_opt.plots import palette
from tepm_opt.plots.palette import ACTUATORS, TOGETHER, Role, channel

LEAST = 0.08
"""Distance in OKLab (Ottosson 2020) that two roles of one panel keep: four times what is just noticeable side by side (0.02)."""

DEUTERANOPIA = np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]])
"""Of linear RGB, severity 1 (Machado, Oliveira, Fernandes, IEEE Trans. Vis. Comput. Graph. 15, 2009, 1291)."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear RGB (ITU-R BT.709)
TO_CONES = np.array(
    [[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566], [0.0883024619, 0.2817188376, 0.6299787005]]
)
TO_LAB = np.array(
    [[0.2104542553, 0.7936177850, -0.0040720468], [1.9779984951, -2.4285922050, 0.4505937099], [0.0259040371, 0.7827717662, -0.8086757660]]
)


def linear(color: str) -> np.ndarray:
    """Linear RGB of a colour."""
    coded = np.array(to_rgb(color))
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def oklab(light: np.ndarray) -> np.ndarray:
    """OKLab coordinates of linear RGB."""
    return TO_LAB @ np.cbrt(TO_CONES @ np.clip(light, 0.0, 1.0))


def distance(one: Role, other: Role, sight: np.ndarray) -> float:
    """Distance of two colours after a linear change of what is seen."""
    return float(np.linalg.norm(oklab(sight @ linear(one.color)) - oklab(sight @ linear(other.color))))


def roles() -> dict[str, Role]:
    """Every role of the palette by its name, those of groups by the group's, and the actuators."""
    found = {name: value for name, value in vars(palette).items() if isinstance(value, Role)}
    for group in ("MODELS", "INPUTS", "AXES", "CONTROLLERS"):
        found |= {f"{group} {name}": role for name, role in getattr(palette, group).items()}
    return found | {f"actuator {k}": Role(color) for k, color in enumerate(ACTUATORS)}


def test_known_distances() -> None:
    """Black and white are 1 apart; pure red and a dark yellow, which those who do not see green mix up, come near each other."""
    assert distance(Role("#000000"), Role("#ffffff"), np.eye(3)) == pytest.approx(1.0, abs=1e-6)
    red, brown = Role("#d0301c"), Role("#857200")
    assert distance(red, brown, np.eye(3)) > 2.5 * distance(red, brown, DEUTERANOPIA)


@pytest.mark.parametrize("panel", TOGETHER)
@pytest.mark.parametrize("sight", [DEUTERANOPIA, np.tile(LUMINANCE, (3, 1))], ids=["deuteranopia", "greyscale"])
def test_roles_of_a_panel_stay_apart(panel: str, sight: np.ndarray) -> None:
    """Black lines (targets, noise, limits, sums) are told by their styles."""
    near = [
        (one.color, other.color, round(distance(one, other, sight), 3))
        for one, other in combinations(TOGETHER[panel], 2)
        if one.color != other.color and distance(one, other, sight) < LEAST
    ]
    assert near == []


@pytest.mark.parametrize("panel", [panel for panel in TOGETHER if panel != "actuators of a module"])
def test_styles_say_it_again(panel: str) -> None:
    """No two roles of a panel have both line and marker in common."""
    styles = [(role.line, role.marker) for role in TOGETHER[panel]]
    assert len(set(styles)) == len(styles)


def test_modules_are_told_by_their_styles() -> None:
    layout = Layout.from_robot(load_robot("kang2017"))
    every = [channel(layout, k) for k in range(layout.modules * layout.actuators)]
    assert len({(role.color, role.line, role.marker) for role in every}) == len(every)
    assert len({role.color for role in every}) == layout.actuators


def test_a_colour_has_one_meaning() -> None:
    """Black is left to reference lines; what stands twice in the palette is the same role."""
    meanings: dict[str, set[int]] = {}
    for role in roles().values():
        meanings.setdefault(role.color, set()).add(id(role))
    assert {color for color, of in meanings.items() if len(of) > 1} <= {"#000000"}
    distinct = sorted(meanings)
    near = [(a, b) for a, b in combinations(distinct, 2) if distance(Role(a), Role(b), np.eye(3)) < 0.05]
    assert near == []


def test_contrast_on_white() -> None:
    """3 and more, as WCAG 2.2, 1.4.11 asks of graphics; obstacles are areas."""
    pale = {name: 1.05 / (LUMINANCE @ linear(role.color) + 0.05) for name, role in roles().items() if name != "OBSTACLE"}
    assert {name: round(ratio, 2) for name, ratio in pale.items() if ratio < 3.0} == {}


def test_figures_take_their_colours_from_the_palette() -> None:
    """No other module of plots makes up colours; greys of the arm in films are no meanings."""
    folder = Path(palette.__file__).parent
    made_up = re.compile(r"""["']#[0-9a-fA-F]{6}["']|["']C\d["']|["']C\{|["']tab:""")
    found = {path.name for path in folder.glob("*.py") if made_up.search(path.read_text(encoding="utf-8"))}
    assert found == {"palette.py", "scene.py"}
