"""The page of a verdict: everything a reader needs, in one file; and the figures in it."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.network import candidate
from tepm_opt.discrepancy.assessment.residual_locations import Localisation
from tepm_opt.discrepancy.assessment.result import Errors, Named, Place, Rival, Value, Verdict, VerdictStatus
from tepm_opt.discrepancy.reporting.effect_table import HEAD, describe_sizes, effect_table, sentences_beside_table
from tepm_opt.models.model import Model
from tepm_opt.plots import save
from tepm_opt.plots.discrepancy import evidence_figure, gap_figure, heat_figure, over_time_figure, points_figure, tip_figure
from tepm_opt.report.discrepancy import summarise_verdict, write_discrepancy_page

PNG = base64.b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg==")
FIGURES = ("heat", "gap", "points", "over_time", "evidence", "tip")
PLACES = (
    Place("run", "steps <1>.csv", 8.1e-3, 0.62, 3.4, 0.001),
    Place("point", "s4", 6.0e-3, 0.7, 2.8, 0.001),
    Place("time", "late", 4.0e-3, 0.3, 1.01, 0.44),
)
LOCALISATION = Localisation(
    PLACES,
    2,
    np.array([[1e-3, 2e-3, 4e-3, 8.1e-3], [0.0, 0.1e-3, np.nan, 1.2e-3]]),
    ("steps <1>.csv", "circle.csv"),
    ("s1", "s2", "s3", "s4"),
    4.2e-3,
    "The model misses by 4.2 mm beyond the noise, most in steps <1>.csv (8.1 mm) and at s4; along x.",
)
VERDICT = Verdict(
    status=VerdictStatus.NAMED,
    sentences=("Muscle 13 is weaker.", "It is 12 % weaker than the others & nothing else is missing."),
    effects=(Named(candidate("actuator_gain", "13"), 0.997, {"loss": Value(0.1203, 0.0007, "1", 0.0)}, 0.94),),
    rivals=(
        Rival(candidate("pressure_crosstalk"), 0.003, "closes 55 % <less> than half the rest", 0.55),
        Rival(candidate("sensor_offset", "s4"), 0.0, "not worth a fit", None),
        *(Rival(candidate("sensor_offset", f"s{k}"), 0.0, "no gain to first order", None) for k in (1, 2, 3)),
    ),
    where=PLACES,
    recalibrated={"K_a": Value(364.2, 0.8, "N/m", 358.86), "c_a": Value(2.4, 0.0, "N s/m", 2.583), "alpha_2": Value(0.98, 0.002, "-", 1.0)},
    errors=Errors(0.52e-3, 5.2e-3, 4.1e-3, 0.55e-3, 0.8e-3),
    model=Model.from_robot("kang2017").with_effect("actuator_gain", "13", loss=0.1203),
    notes=("c_a and alpha_2 cannot be told apart by these runs", "3 samples of s2 were doubtful"),
    seconds=83.4,
)
PROVENANCE = {"data set": "bench <b>bold</b>", "robot": "kang2017", "seed": "0"}


class Page(HTMLParser):
    """Elements and visible text of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words = ""
        self.feed(text)
        self.words = " ".join(self.words.split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words += data


def written(folder: Path, verdict: Verdict = VERDICT, localisation: Localisation = LOCALISATION, figures: tuple[str, ...] = FIGURES) -> str:
    write_discrepancy_page(folder / "report.html", verdict, localisation, dict.fromkeys(figures, PNG), PROVENANCE)
    return (folder / "report.html").read_text(encoding="utf-8")


def test_key_facts(tmp_path: Path) -> None:
    words = Page(written(tmp_path)).words
    facts = (
        "The missing effect is named", VERDICT.sentences[1], LOCALISATION.sentence,
        "effectwheresize ± stdprobabilitygap only it closes", "actuator_gain", "actuator 13", "loss 12.03 ± 0.07 %", "1.00",
        "steps <1>.csv", "8.10 mm", "62 %", "0.001",
        "actuator_gain[13]", "actuator 13", "loss", "0.1203 ± 0.0007", "> 99 %", "94 %",
        "pressure_crosstalk", "closes 55 % <less> than half the rest", "sensor_offset[s4]",
        "noise floormm0.520", "nominalmm5.20", "recalibratedmm4.10", "correctedmm0.550", "black boxmm0.800",
        "K_a", "358.86 N/m", "364.2 ± 0.8 N/m", "+1.49 %", "2.4 N s/m", "alpha_210.98 ± 0.002 −2.00 %",
        *VERDICT.notes, "--model model.toml", "bench <b>bold</b>", "kang2017", "83 s",
    )  # fmt: skip
    assert not [fact for fact in facts if fact not in words]
    places = [words.index(text) for text in ("gap only it closes", VERDICT.sentences[1], "noise floormm", LOCALISATION.sentence)]
    assert places == sorted(places), "the answer first, then its reasons"
    assert "timelate" not in words.replace(" ", ""), "places that do not stand out are left out"


def test_one_file_without_links_or_scripts(tmp_path: Path) -> None:
    text = written(tmp_path)
    page = Page(text)
    assert not {tag for tag, _ in page.elements} & {"script", "link", "iframe", "object", "embed", "base", "a"}
    assert not re.search(r"https?://|//[a-z]+\.|url\(|@import", re.sub(r"base64,[A-Za-z0-9+/=]+", "", text))
    images = [attributes for tag, attributes in page.elements if tag == "img"]
    assert len(images) == len(FIGURES)
    assert all(base64.b64decode((image["src"] or "").removeprefix("data:image/png;base64,")) == PNG and image["alt"] for image in images)


def test_names_are_escaped(tmp_path: Path) -> None:
    text = written(tmp_path)
    assert "<b>bold" not in text
    assert "steps <1>" not in text
    assert "steps &lt;1&gt;.csv" in text


@pytest.mark.parametrize("status", list(VerdictStatus))
def test_every_status(tmp_path: Path, status: VerdictStatus) -> None:
    effects = () if status in (VerdictStatus.NO_DISCREPANCY, VerdictStatus.UNEXPLAINED) else VERDICT.effects
    text = written(tmp_path, replace(VERDICT, status=status, effects=effects))
    assert f'class="verdict {status.value}"' in text
    assert ("No effect was added" in text) == (not effects)
    assert ("no gap" in text) == (status is VerdictStatus.NO_DISCREPANCY)


def test_several_effects_are_not_one() -> None:
    assert [summarise_verdict(VerdictStatus.NAMED, count) for count in (1, 2)] == [
        "The missing effect is named",
        "The missing effects are named",
    ]
    assert [summarise_verdict(VerdictStatus.PARTIAL, count) for count in (1, 3)] == [
        "A known effect explains a part",
        "Known effects explain a part",
    ]
    assert summarise_verdict(VerdictStatus.INDISTINGUISHABLE, 2) == "Several effects explain the data equally well"


def test_what_is_not_there_is_left_out(tmp_path: Path) -> None:
    bare = Verdict(
        VerdictStatus.NO_DISCREPANCY,
        ("Nothing is missing.",),
        (),
        (),
        (),
        {},
        Errors(5e-4, 4.9e-4, 4.9e-4, 4.9e-4, float("nan")),
        Model.from_robot("kang2017"),
    )
    silent = Localisation((), 0, np.zeros((1, 4)), ("a.csv",), ("s1", "s2", "s3", "s4"), 0.0, "No structure above the noise.")
    page = Page(written(tmp_path, bare, silent, ()))
    assert "img" not in {tag for tag, _ in page.elements}
    assert "No part of the data stands out" in page.words
    assert not [words for words in ("nan mm", "nan %", "recalibrated, ", "rejected") if words in page.words]


def test_figures_may_be_files(tmp_path: Path) -> None:
    (tmp_path / "heat.png").write_bytes(PNG)
    write_discrepancy_page(tmp_path / "report.html", VERDICT, LOCALISATION, {"heat": tmp_path / "heat.png"}, PROVENANCE)
    assert base64.b64encode(PNG).decode() in (tmp_path / "report.html").read_text(encoding="utf-8")


def measured(static: bool) -> tuple[list[Run], dict[str, list[np.ndarray]]]:
    """Two runs, the second with the error in 10 … 20 s, along y at the tip; some samples missing."""
    random, time = np.random.default_rng(0), np.arange(0.0, 30.0, 0.1)
    runs, models = [], {"nominal": [], "recalibrated": [], "corrected": []}
    for number in range(2):
        points = 0.1 * random.normal(size=(4, 3)) + 0.01 * np.sin(time)[:, None, None]
        error = np.zeros_like(points)
        error[:, -1, 1] = 5e-3 * number * ((time > 10) & (time < 20))
        seen = points + 3e-4 * random.normal(size=points.shape)
        seen[random.random(points.shape) < 0.05] = np.nan
        shown = np.full_like(time, np.nan) if static else time
        runs.append(Run(f"run_{number}.csv", "validation", shown, np.zeros((len(time), 12)), np.zeros((len(time), 3)), seen))
        for name, part in (("nominal", 1.0), ("recalibrated", 0.7), ("corrected", 0.0)):
            models[name].append(points - part * error)
    return runs, models


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("static", [False, True])
def test_figures_of_runs(tmp_path: Path, static: bool) -> None:
    runs, models = measured(static)
    figures = {"over_time": over_time_figure(runs, models, 5e-4), "tip": tip_figure(runs, models)}
    for name, figure in figures.items():
        save(figure, tmp_path / f"{name}.png")
    assert [axes.get_title(loc="left") for axes in figures["over_time"].axes] == ["run_0.csv", "run_1.csv"]
    above = figures["tip"].axes[0]
    assert above.get_title().startswith("run_1.csv")
    assert above.get_ylabel() == "tip y in mm"
    if not static:
        shown = np.asarray(above.lines[0].get_xdata())
        assert shown.min() > 9.0
        assert shown.max() < 21.0


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_figures_of_numbers(tmp_path: Path) -> None:
    errors = {"noise floor": 5e-4, "nominal": 5e-3, "recalibrated": 4e-3, "corrected": 5.5e-4, "black box": float("nan")}
    figures = [
        heat_figure(LOCALISATION.heat, LOCALISATION.runs, LOCALISATION.points),
        heat_figure(np.full((1, 2), np.nan), ("a.csv",), ("s1", "s2")),
        gap_figure(errors),
        gap_figure(errors | {"noise floor": 0.0}),
        points_figure(("s1", "s2"), {"nominal": np.array([1e-3, np.nan]), "corrected": np.array([4e-4, 5e-4])}, 5e-4),
        evidence_figure({"creep": 0.1, "payload": -0.2, "actuator_gain[13]": 0.95}, {"actuator_gain[13]"}),
        evidence_figure({}, ()),
    ]
    for k, figure in enumerate(figures):
        save(figure, tmp_path / f"{k}.png")
    assert figures[2].axes[0].get_xscale() == "log"
    assert figures[3].axes[0].get_xscale() == "linear"
    assert "black box" not in [tick.get_text() for tick in figures[2].axes[0].get_yticklabels()]
    assert [tick.get_text() for tick in figures[5].axes[0].get_yticklabels()] == ["actuator_gain[13]", "creep", "payload"]


def test_the_table_says_where_only_if_an_effect_acts_somewhere() -> None:
    load = Named(candidate("payload"), 1.0, {"mass": Value(0.02, 1e-4, "kg", 0.0)}, 0.27)
    weak = Named(candidate("actuator_gain", "13"), 0.9, {"loss": Value(0.1, 0.01, "1", 0.0)}, 0.5)
    verdict = replace(VERDICT, effects=(load,))
    assert effect_table(verdict) == (
        ("effect", "size ± std", "probability", "gap only it closes"), [("payload", "mass 20 ± 0.1 g", "1.00", "27 %")],
    )  # fmt: skip
    head, rows = effect_table(replace(verdict, effects=(load, weak)))
    assert head == HEAD
    assert [row[1] for row in rows] == ["–", "actuator 13"]


def test_beside_the_table_stand_the_errors_alone() -> None:
    """The table has the first sentence, the section on places their own; where effects stand for each other the first one tells it."""
    verdict = replace(VERDICT, sentences=("Missing: x.", "The error falls.", "It misses at s4."))
    assert sentences_beside_table(verdict, "It misses at s4.") == ("The error falls.",)
    alike = replace(verdict, status=VerdictStatus.INDISTINGUISHABLE)
    assert sentences_beside_table(alike, "It misses at s4.") == ("Missing: x.", "The error falls.")
    nothing = replace(verdict, effects=(), status=VerdictStatus.NO_DISCREPANCY, sentences=("Nothing is missing.", "The error falls."))
    assert sentences_beside_table(nothing, "") == nothing.sentences


def test_many_sizes_that_are_not_told_from_null_stay_short() -> None:
    """Else one cell makes the whole table wider than a terminal."""
    values = {f"gain_{k}": Value(0.001, 0.01, "1", 0.0) for k in range(9)}
    (cell,) = describe_sizes(Named(candidate("actuator_scatter"), 0.8, values, 0.01))
    assert cell == "gain 0, gain 1 and 7 more not significantly different from 0"
