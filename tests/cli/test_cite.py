"""`tepm cite`: the facts of CITATION.cff, sources that the code names, entries that BibTeX can read."""

from __future__ import annotations

import re
from pathlib import Path

from tepm_opt.cli.cite import read_sources
from tepm_opt.models.model import Model, write_model
from tests.cli.conftest import Command
from tests.docs.texts import ROOT

CITATION = (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_toolkit_and_paper_are_those_of_the_citation_file(tepm: Command) -> None:
    toolkit, paper = list(read_sources().values())[:2]
    assert f'title: "{toolkit["title"]}"' in CITATION
    assert f"name: {toolkit['author'].strip('{}')}\n" in CITATION
    assert f"date-released: {toolkit['year']}-" in CITATION
    assert f"title: {paper['title']}\n" in CITATION
    assert f"year: {paper['year']}\n" in CITATION
    names = re.findall(r"family-names: (.+), given-names: (.+)}", CITATION)
    assert " and ".join(", ".join(name) for name in names) == paper["author"]
    done = tepm("cite")
    assert done.status == 0
    assert done.out.index("tepm_opt authors") < done.out.index("Kang, Rongjie; Guo, Yong") < done.out.index("Nocedal")
    assert re.search(r"version: (\S+)\ndate", CITATION)[1] in done.out.splitlines()[1]  # type: ignore[index]


def test_the_code_names_every_source() -> None:
    """A method is cited because its module says where it is from; CasADi is a dependency, toolkit and paper are this project's."""
    code = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tepm_opt").rglob("*.py"))
    methods = list(read_sources().values())[3:]
    assert len(methods) > 10
    assert [work["title"] for work in methods if work["author"].partition(",")[0] not in code] == []


def test_entries_are_bibtex(tepm: Command) -> None:
    out = tepm("cite", "--format", "bibtex").out
    entries = re.findall(r"^@(\w+)\{(\w+),\n(.*?)^\}$", out, re.S | re.M)
    assert [key for _, key, _ in entries] == list(read_sources())
    needed = {"article": "journal", "book": "publisher", "incollection": "booktitle", "inproceedings": "booktitle", "misc": "title"}
    for kind, key, fields in entries:
        found = dict(re.findall(r"^  (\w+) = \{(.*)\},$", fields, re.M))
        assert {"author", "title", "year", "note", needed[kind]} <= found.keys(), key
        assert all(text.count("{") == text.count("}") for text in found.values()), key
        assert not re.search(r"(?<!\\)[_&%^]", fields), key


def test_effects_of_a_model_are_cited(tepm: Command, here: Path) -> None:
    write_model(Model.from_robot("kang2017").with_effect("regulator_lag"), here / "model.toml")
    assert "effect regulator_lag:\n    Richer and Hurmuzlu" in tepm("cite", "--model", "model.toml").out
    assert "@misc{regulator_lag," in tepm("cite", "--model", "model.toml", "--format", "bibtex").out
    wrong = tepm("cite", "--model", "none.toml")
    assert (wrong.status, "none.toml" in wrong.err) == (2, True)


def test_another_format_is_refused(tepm: Command) -> None:
    wrong = tepm("cite", "--format", "ris")
    assert wrong.status == 2
    assert "'text', 'bibtex'" in wrong.err
