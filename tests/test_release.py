"""Releases: one version and date everywhere, every extra documented, wheel and sdist complete and without anything else."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
FOR_DEVELOPERS = {"test", "bench", "dev", "docs"}
SOURCE = (".py", ".pyi")


def test_one_version_and_one_date() -> None:
    """CHANGELOG begins with the version of pyproject.toml, or with what comes after it; CITATION.cff tells the release."""
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    released = re.findall(r"^## (\d+\.\d+\.\d+) \((\d{4}-\d\d-\d\d)\)$", changelog, re.M)
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    cited = re.search(r"^version: (\S+)\ndate-released: (\S+)$", citation, re.M)
    assert cited
    assert released[0] == cited.groups()
    assert released[0][0] == PROJECT["version"]
    assert f"license: {PROJECT['license']}\n" in citation


def test_every_extra_is_listed() -> None:
    page = (ROOT / "docs" / "reference" / "files.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\w+)` \| .+ \| \d+ \|$", page, re.M)
    assert set(listed) == set(PROJECT["optional-dependencies"]) - FOR_DEVELOPERS


def committed(*folders: str) -> set[str]:
    """Files of the last commit, all or those below these folders."""
    command = ["git", "ls-tree", "-r", "-z", "--name-only", "HEAD", *folders]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if told.returncode:
        pytest.skip("not a git repository")
    return {name for name in told.stdout.split("\0") if name}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with wheel and sdist, built from the last commit and nothing else."""
    for name in ("build", "hatchling"):
        pytest.importorskip(name)
    committed()
    folder = tmp_path_factory.mktemp("release")
    subprocess.run(["git", "archive", "-o", str(folder / "tree.tar"), "HEAD"], cwd=ROOT, check=True)
    with tarfile.open(folder / "tree.tar") as tree:
        tree.extractall(folder / "tree", filter="data")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder / "dist"), str(folder / "tree")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "dist"


@pytest.mark.slow
def test_the_wheel_is_the_package(built: Path) -> None:
    (path,) = built.glob("*.whl")
    with zipfile.ZipFile(path) as wheel:
        contents = {name: wheel.read(name) for name in wheel.namelist()}
    information = f"tepm_opt-{PROJECT['version']}.dist-info/"
    package = {name for name in contents if not name.startswith(information)}
    assert package == committed("tepm_opt")
    kinds = {PurePosixPath(name).suffix for name in package if not name.endswith(SOURCE)}
    assert {".c", ".h", ".cpp", ".toml", ".html", ".css", ".js", ".ino"} <= kinds
    assert f"{information}licenses/LICENSE" in contents
    told = Parser().parsestr(contents[f"{information}METADATA"].decode())
    assert (told["Name"], told["Version"], told["License-Expression"]) == (PROJECT["name"], PROJECT["version"], PROJECT["license"])
    assert set(told.get_all("Provides-Extra", [])) == set(PROJECT["optional-dependencies"])
    assert not [name for name, content in contents.items() if places(built, content)]


@pytest.mark.slow
def test_the_sdist_is_the_tree(built: Path) -> None:
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as sdist:
        contents = {each.name: sdist.extractfile(each).read() for each in sdist.getmembers() if each.isfile()}  # type: ignore[union-attr]
    names = {name.partition("/")[2] for name in contents}
    assert names == committed() | {"PKG-INFO"}
    assert not [name for name, content in contents.items() if places(built, content)]


def places(built: Path, content: bytes) -> list[str]:
    """Absolute paths of the machine that built: of the tree, of this repository and of this Python."""
    return [str(each) for each in (built.parent, ROOT, Path(sys.prefix)) if str(each).encode() in content]
