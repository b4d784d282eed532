"""Every page as its readers meet it: on a desk and a phone, light and dark, with a keyboard, on paper. Results are small stand-ins."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.goals import faster
from benchmarks.page import write_benchmark_page
from benchmarks.timing import Contender, Task
from tepm_opt.hw.simulation.rigfile import load_rig_file
from tepm_opt.jobs.demo import DemoRun
from tepm_opt.jobs.gain import run_gain
from tepm_opt.jobs.ik import run_ik
from tepm_opt.jobs.model_update import ModelUpdate
from tepm_opt.models.compile import CompiledModel
from tepm_opt.plots.palette import NOMINAL
from tepm_opt.report.charts import MOST, Curve, Curves, Panel, discovery_charts
from tepm_opt.report.demo import write_page
from tepm_opt.report.discrepancy import write_discrepancy_page
from tepm_opt.report.model_update import write_model_update_page
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.planning.trajectories import circle
from tepm_opt.studies.blind.page import write_blind_page
from tepm_opt.studies.blind.run import BlindRun
from tepm_opt.studies.blind.trial import TrialSeries
from tepm_opt.studies.paper.page import write_paper_page
from tepm_opt.studies.paper.result import ExperimentResult
from tests.browser import DESK, PHONE, Browser
from tests.discrepancy.test_report import LOCALISATION, PNG, PROVENANCE, VERDICT, measured
from tests.studies.blind.test_analysis import GAIN, result

ERRORS = {"noise_floor": 1e-3, "nominal": 3e-2, "recalibrated": 2.5e-2, "corrected": 2e-3, "black_box": float("nan")}


@dataclass
class Loop:
    """A closed loop on a circle that is missed by a constant."""

    controller: str
    miss: float
    time: np.ndarray = field(default_factory=lambda: np.arange(0.0, 10.0, 0.02))
    ok: bool = True

    def __post_init__(self) -> None:
        self.setup = SimpleNamespace(controller=self.controller)
        self.truth = np.zeros((len(self.time), 3))
        self.counted = self.time > 2.0

    def errors(self, true: bool) -> np.ndarray:
        return self.miss * (1.0 + 0.3 * np.sin(7 * self.time))[:, None] * np.ones(3) / np.sqrt(3)

    def summary(self, timing: bool = True) -> dict[str, Any]:
        band = {"from_Hz": 0.0, "to_Hz": 0.5, "share_of_tension": 0.04}
        return {
            "errors": {"true": {"rms_m": self.miss, "largest_m": 1.3 * self.miss}, "tracked": None},
            "message": "", "counted_seconds": 8.0, "pressure_moves_per_s": 40.0, "motors_enabled": 0.99,
            "mean_tension_of_mid_range": None, "actuation": [band, band | {"from_Hz": 0.5, "to_Hz": 2.0}],
        }  # fmt: skip


def pictures(folder: Path, *names: str) -> dict[str, Path]:
    """Figures of one pixel, which are drawn as wide as their column."""
    for name in names:
        (folder / f"{name}.png").write_bytes(PNG)
    return {name: folder / f"{name}.png" for name in names}


def demo_page(folder: Path, model: CompiledModel) -> Path:
    path = circle(points=4)
    hybrid = run_ik(model, path)
    loops: Any = {"mode 1": Loop("mode1", 46e-3), "MPC": Loop("mpc", 1.1e-3)}
    run = DemoRun(run_ik(model, path, ActuationMode.PRESSURE), hybrid, run_gain(model, hybrid.setpoints()), loops)
    write_page(folder / "demo.html", run, pictures(folder, "ik", "gain", "path", "distance", "inputs"))
    return folder / "demo.html"


def discovery() -> Any:
    """What the charts of a verdict need of it."""
    runs, models = measured(static=False)
    dataset = SimpleNamespace(runs=tuple(runs), validation=tuple(runs))
    return SimpleNamespace(dataset=dataset, predictions=models, noise=3e-4, localisation=LOCALISATION, verdict=VERDICT)


def discrepancy_page(folder: Path, model: CompiledModel) -> Path:
    figures: Any = pictures(folder, "heat", "gap", "points", "evidence")
    write_discrepancy_page(folder / "report.html", VERDICT, LOCALISATION, figures, PROVENANCE, discovery_charts(discovery()))
    return folder / "report.html"


def closing_page(folder: Path, model: CompiledModel) -> Path:
    effects = [{"name": "an_effect", "detail": "13", "probability": 0.99, "parameters": {}}]
    verdict = {"status": "named", "effects": effects, "rmse_m": ERRORS, "paragraph": "It carries something & more."}
    verdict |= {"table": [["effect", "size ± std", "probability", "gap only it closes"], ["an_effect", "loss 10 ± 1 %", "0.99", "94 %"]]}
    of = {name: {"errors": {"true": {"rms_m": rms}, "tracked": None}} for name, rms in (("nominal", 2e-3), ("corrected", 1e-3))}
    write_model_update_page(folder / "closed.html", ModelUpdate(folder, "kang2017", "sim", (verdict,), {"circle": of}))
    return folder / "closed.html"


def paper_page(folder: Path, model: CompiledModel) -> Path:
    row = {"figure": "fig7", "text": "RMSE, Eq. (5)", "unit": "mm", "published": 5.32, "ours": 5.35, "ratio": 1.01, "within": True}
    check = {"figure": "fig7", "text": "the error grows from the base to the tip", "holds": False}
    summary = {"robot": "kang2017", "rig": "virtual prototype", "interrupted": False, "quick": True, "numbers": 2, "within_15_percent": 1}
    summary |= {"rows": [row, row | {"ours": 120.0, "within": False}], "checks": [check]}
    results = [ExperimentResult("fig7", "Elongation", "From rest.", {"fig7_rmse": 5.35}, {check["text"]: False})]
    write_paper_page(folder / "paper.html", summary, results, pictures(folder, "fig7"), load_rig_file("virtual_prototype"))
    return folder / "paper.html"


def blind_page(folder: Path, model: CompiledModel) -> Path:
    found = [result("closed", GAIN, "named", [("actuator_gain", "12", 0.9)], number) for number in range(12)]
    run = BlindRun(TrialSeries(13), (*found, result("null", [], "no_discrepancy", [])))
    write_blind_page(folder / "blind.html", run, pictures(folder, "rates", "confusion"))
    return folder / "blind.html"


def benchmark_page(folder: Path, model: CompiledModel) -> Path:
    def contender(name: str, seconds: float) -> Contender:
        return Contender(name, lambda: None, lambda _: np.zeros(1), rounds={0: [seconds, 1.1 * seconds]}, verdict="right")

    task = Task("warm", "statics, warm", np.zeros(1), [contender("ours", 4e-5), contender("IPOPT", 3e-3)])
    goals = [(goal, task, 75.0) for goal in (faster("warm", "statics", 10, "IPOPT"), faster("warm", "statics", 100, "IPOPT"))]
    write_benchmark_page(folder / "benchmarks.html", goals, [task], "pinned to one core")
    return folder / "benchmarks.html"


PAGES = {
    "demo": demo_page,
    "discrepancy": discrepancy_page,
    "close": closing_page,
    "paper": paper_page,
    "blind": blind_page,
    "bench": benchmark_page,
}
FIRST = {
    "demo": "With the MPC the simulated robot's tip stays within 1.10 mm rms of its moving target (46.0 mm in mode 1).",
    "discrepancy": "The missing effect is named.",
    "close": "The missing effect is named.",
    "paper": "1 of 2 published numbers come out within 15 %.",
    "blind": " limits are kept in 13 trials.",
    "bench": "1 of 2 targets are met.",
}


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory, kang: CompiledModel) -> Callable[[str], Path]:
    """The page of a name, written once."""
    made: dict[str, Path] = {}

    def page(name: str) -> Path:
        if name not in made:
            made[name] = PAGES[name](tmp_path_factory.mktemp(name), kang)
        return made[name]

    return page


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    ("width", "dark"),
    [
        pytest.param(PHONE, False, id="phone-light"),
        pytest.param(DESK, True, id="desk-dark"),
        pytest.param(PHONE, True, id="phone-dark", marks=pytest.mark.slow),
        pytest.param(DESK, False, id="desk-light", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("name", PAGES)
def test_pages_can_be_read(browser: Browser, pages: Callable[[str], Path], name: str, width: int, dark: bool) -> None:
    browser.open(pages(name), width, dark).check(keyboard=width == PHONE and not dark)
    assert browser.requests() == []


@pytest.mark.parametrize("name", PAGES)
def test_the_verdict_comes_first(pages: Callable[[str], Path], name: str) -> None:
    """Before it stands the heading alone, behind it the table with a unit in every row; one file that loads nothing."""
    text = pages(name).read_text(encoding="utf-8")
    body = text[text.index("<body>") :]
    before, _, rest = body.partition('<div class="verdict')
    assert re.sub(r"<[^>]*>|\s", "", before.partition("<h1>")[0]) == ""
    bold = re.search(r"<b>(.*?)</b>", rest)
    assert bold
    assert FIRST[name] in bold[1].replace("&#39;", "'")
    assert rest.index("<table") < rest.index("<h2") if "<h2" in rest else "<table" in rest
    assert not re.search(r"(?:src|href)=[\"'](?!data:)|@import|url\((?!#)", text)


@pytest.mark.parametrize("name", PAGES)
def test_numbers_that_matter_are_seen_on_a_phone(browser: Browser, pages: Callable[[str], Path], name: str) -> None:
    """The first number of every row of the first table, without scrolling sideways; demo: MPC's."""
    browser.open(pages(name), PHONE)
    hidden = "[...document.querySelector('table').rows].map(row => row.cells[Math.min(2, row.cells.length - 1)])"
    assert browser.run(f"return {hidden}.filter(cell => cell.getBoundingClientRect().right > {PHONE}).map(cell => cell.textContent)") == []
    if name == "demo":
        assert browser.run(f"return {hidden}.slice(0, 2).map(cell => cell.textContent)") == ["MPC", "1.10"]


@pytest.fixture
def chart(browser: Browser, tmp_path: Path) -> Browser:
    """A verdict's page with a chart of the tip over 30 s."""
    return browser.open(discrepancy_page(tmp_path, None))  # type: ignore[arg-type]


def across(browser: Browser, name: str = "over_time") -> list[float]:
    """Numbers below the first panel of a chart."""
    found = f"document.querySelector('[data-of={name}] svg.plot').querySelectorAll('text[text-anchor=middle]')"
    texts = browser.run(f"return [...{found}].map(e => e.textContent)")
    return [float(text.replace("−", "-")) for text in texts if re.fullmatch(r"[−\d.]+", text)]


def box(browser: Browser, name: str) -> list[float]:
    """Left, top, width and height of the first panel of a chart, brought into the window."""
    panel = f"document.querySelector('[data-of={name}] svg.plot')"
    browser.run(f"{panel}.scrollIntoView({{block: 'center'}})")
    return browser.run(f"const b = {panel}.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]")


def press(browser: Browser, label: str, name: str = "over_time") -> None:
    """Press a button of a chart by keyboard."""
    browser.run("document.querySelector(`[data-of=${arguments[0]}] button[aria-label='${arguments[1]}']`).focus()", name, label)
    browser.press("ENTER")


@pytest.mark.slow
def test_time_series_can_be_zoomed(chart: Browser) -> None:
    """By keyboard and by dragging."""
    assert (min(across(chart)), max(across(chart))) == (0.0, 25.0)
    press(chart, "zoom in")
    assert min(across(chart)) >= 7.0
    assert max(across(chart)) <= 23.0
    press(chart, "earlier")
    assert min(across(chart)) < 2.0
    press(chart, "show all")
    assert max(across(chart)) == 25.0
    left, top, wide, high = box(chart, "over_time")
    chart.drag((left + 0.5 * wide, top + high / 2), (left + 0.6 * wide, top + high / 2))
    assert 12.0 < min(across(chart)) < max(across(chart)) < 20.0
    assert "corrected" in chart.run("return document.querySelector('[data-of=over_time] .told').textContent")
    assert chart.messages() == []


def test_the_tip_is_shown_where_correction_matters_first(chart: Browser) -> None:
    assert min(across(chart, "tip")) > 8.0
    assert max(across(chart, "tip")) < 22.0


def told(browser: Browser, name: str) -> str:
    """What is said below a chart."""
    return browser.run(f"return document.querySelector('[data-of={name}] .told').textContent")


def test_plots_take_keys(chart: Browser) -> None:
    """Values at a place, which a line marks; zoom and back."""
    chart.run("document.querySelector('[data-of=over_time] svg.plot').focus()")
    chart.press("HOME")
    assert told(chart, "over_time").startswith("time 0 s; Eq. (5) in mm: nominal ")
    chart.press("ARROW_RIGHT", "ARROW_RIGHT")
    assert told(chart, "over_time").startswith("time 1.")
    left = "return document.querySelector('[data-of=over_time] .cursor').getBBox().x"
    before = chart.run(left)
    chart.press("END")
    assert chart.run(left) > before + 500
    chart.press("+")
    assert max(across(chart)) < 25.0
    chart.press("0")
    assert (min(across(chart)), max(across(chart))) == (0.0, 25.0)


def test_curves_can_be_hidden(chart: Browser) -> None:
    count = "return document.querySelectorAll('[data-of=over_time] svg.plot')[0].querySelectorAll('g path').length"
    before = chart.run(count)
    press(chart, "show or hide nominal")
    assert chart.run(count) == before - 1
    assert chart.run("return document.querySelector('[data-of=over_time] button').getAttribute('aria-pressed')") == "false"


@pytest.mark.slow
def test_the_robot_can_be_turned(browser: Browser, pages: Callable[[str], Path]) -> None:
    """By buttons, by dragging, and another point by the slider's keys."""
    browser.open(pages("demo"))
    drawn = "return document.querySelector('[data-of=robot] svg.plot').innerHTML"
    seen = [browser.run(drawn)]
    press(browser, "turn left", "robot")
    seen.append(browser.run(drawn))
    left, top, _, _ = box(browser, "robot")
    browser.drag((left + 300, top + 100), (left + 350, top + 120))
    seen.append(browser.run(drawn))
    browser.run("document.querySelector('[data-of=robot] svg.plot').focus()")
    browser.press("ARROW_UP")
    seen.append(browser.run(drawn))
    browser.run("document.querySelector('[data-of=robot] input').focus()")
    browser.press("ARROW_RIGHT")
    seen.append(browser.run(drawn))
    assert len(set(seen)) == 5
    assert browser.run("return document.querySelector('[data-of=robot] .told').textContent").startswith("point 2: tip at x ")


def test_paper_is_white(chart: Browser) -> None:
    """Also where the screen is dark; what only a screen can do is left out."""
    chart.media(dark=True, print_=True)
    assert chart.run("return getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert chart.run("return document.querySelector('[aria-label=\"zoom in\"]').checkVisibility()") is False
    assert chart.pale() == []


def test_long_curves_keep_their_peaks() -> None:
    time = np.linspace(0.0, 100.0, 20_001)
    values = np.zeros_like(time)
    values[12_345] = 7.0
    values[:50] = np.nan
    data = json.loads(json.dumps(Curves("t", "a", [Panel(time, "s", "mm", [Curve("c", NOMINAL, values)])]).data()))["panels"][0]
    shown = data["series"][0]["values"]
    assert len(data["x"]) == len(shown) <= MOST
    assert max(value for value in shown if value is not None) == 7.0
    assert abs(data["x"][shown.index(7.0)] - time[12_345]) < 0.1
    assert shown[0] is None
    assert data["x"] == sorted(data["x"])


def test_a_job_without_loops_says_why(tmp_path: Path, kang: CompiledModel) -> None:
    hybrid = run_ik(kang, circle(points=4))
    run = DemoRun(run_ik(kang, circle(points=4), ActuationMode.PRESSURE), hybrid, run_gain(kang, hybrid.setpoints()), note="no <rig>")
    write_page(tmp_path / "demo.html", run, pictures(tmp_path, "ik", "gain"))
    text = (tmp_path / "demo.html").read_text(encoding="utf-8")
    assert '<div class="verdict bad">' in text
    assert '<td>A</td><td class="unit">m²</td><td>5.027e-05</td><td>robot file</td>' in text
    assert "<td>&lt; 0.001</td>" in text, "what a solver leaves has no size"
    assert "No closed loop: no &lt;rig&gt;." in text
