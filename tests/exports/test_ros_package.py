"""The example package of ROS 2: its files parse, name what there is, and its URDF is what is exported."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from xml.etree import ElementTree as Xml

import pytest

from tepm_opt.exports.urdf import urdf
from tepm_opt.hw.ros.messages import TOPICS
from tepm_opt.hw.ros.publishing import STOP
from tepm_opt.models.robot import load_robot

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "examples" / "ros2" / "tepm_description"


def text(name: str) -> str:
    """A file of the package."""
    return (PACKAGE / name).read_text(encoding="utf-8")


def test_the_urdf_is_the_exported_one() -> None:
    """Written anew whenever the robot or the export changes: tepm export urdf."""
    assert text("urdf/kang2017.urdf") == urdf(load_robot("kang2017"))


def test_the_package_and_its_launch_file() -> None:
    """Every node launched is a dependency, and every file named is there."""
    package = Xml.fromstring(text("package.xml"))
    tree = ast.parse(text("launch/display.launch.py"))
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "Node"]
    named = {ast.literal_eval(word.value) for node in nodes for word in node.keywords if word.arg == "package"}
    assert named == {each.text for each in package.findall("exec_depend")}
    assert len(nodes) == 3
    assert package.findtext("name") == PACKAGE.name
    files = re.findall(r'share / "(\w+)" / "([\w.]+)"', text("launch/display.launch.py"))
    assert len(files) == 2
    assert all((PACKAGE / folder / name).is_file() for folder, name in files)
    installed = re.search(r"install\(DIRECTORY ([\w ]+) DESTINATION", text("CMakeLists.txt"))
    assert installed
    assert all((PACKAGE / folder).is_dir() for folder in installed[1].split())


def test_rviz_shows_topics_that_there_are() -> None:
    """Its fixed frame is the URDF's root."""
    yaml = pytest.importorskip("yaml")
    settings = yaml.safe_load(text("rviz/tepm.rviz"))["Visualization Manager"]
    root = Xml.fromstring(text("urdf/kang2017.urdf"))
    links, children = ({each.attrib[name] for each in root.iter(tag)} for tag, name in (("link", "name"), ("child", "link")))
    assert {settings["Global Options"]["Fixed Frame"]} == links - children
    shown = {display["Topic"]["Value"] for display in settings["Displays"] if "Topic" in display}
    assert shown <= set(TOPICS)
    assert len(shown) == 2


@pytest.mark.parametrize("path", [PACKAGE / "README.md", ROOT / "docs" / "how-to" / "ros2.md"])
def test_message_maps_are_complete(path: Path) -> None:
    """Every topic with its type, and the service."""
    rows = [row for row in path.read_text(encoding="utf-8").splitlines() if row.startswith("| `/")]
    types = {topic: row.split("|")[2].strip(" `") for row in rows for topic in re.findall(r"`(/[\w/]+)`", row.split("|")[1])}
    assert {topic: types.get(topic) for topic in TOPICS} == {topic: kind.replace("/msg/", "/") for topic, kind in TOPICS.items()}
    assert STOP in path.read_text(encoding="utf-8")
