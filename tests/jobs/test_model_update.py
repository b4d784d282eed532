"""The loop of the whole toolkit: in what order its parts are asked, what is kept, what the page says; the parts have tests of their own."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tepm_opt.errors import InputError
from tepm_opt.jobs import model_update
from tepm_opt.jobs.discrepancy import DiscrepancyOptions
from tepm_opt.jobs.record import RigSource
from tepm_opt.models.model import Model, write_model
from tepm_opt.recording.plan import read_plan
from tepm_opt.report.model_update import write_model_update_page
from tepm_opt.solvers.planning.trajectories import circle

MODEL = Model.from_robot("kang2017")
PLAN = Path(__file__).resolve().parents[2] / "docs" / "plan.toml"
ERRORS = {"noise_floor": 1e-3, "nominal": 3e-2, "recalibrated": 2.5e-2, "corrected": 2e-3, "black_box": 2e-2}


class Parts:
    """Stand-ins for the parts, which write what the true ones leave and say that they were asked."""

    def __init__(self, statuses: Sequence[str], separable: bool = True) -> None:
        self.statuses, self.separable = list(statuses), separable
        self.asked: list[str] = []

    def record(self, plan: Any, folder: Path, *rest: Any) -> None:
        self.asked.append(f"record {folder.name}")

    def run_discrepancy(self, folder: Path, out: Path, model: Path, options: DiscrepancyOptions, progress: Any) -> None:
        self.asked.append(f"discrepancy {' '.join(each.name for each in (folder, *map(Path, options.add)))}")
        out.mkdir()
        effects = [{"name": "payload", "detail": None, "probability": 0.99, "parameters": {}}]
        content = {"status": self.statuses.pop(0), "effects": effects, "rmse_m": ERRORS, "paragraph": "It carries something."}
        content["table"] = [["effect", "size ± std", "probability", "gap only it closes"], ["payload", "mass 20 ± 1 g", "0.99", "94 %"]]
        (out / "verdict.json").write_text(json.dumps(content))
        write_model(MODEL.with_effect("payload", mass=0.05), out / "model.toml")

    def run_next(self, found: Path, *rest: Any, **more: Any) -> Any:
        self.asked.append(f"next {found.name}")
        if not self.separable:
            raise InputError("no run tells them apart")
        return self

    def save(self, path: Path) -> None:
        path.write_text(PLAN.read_text())

    def run_closed_loop(self, model: Any, reference: Any, rig: Any, setup: Any, folder: Path, **rest: Any) -> None:
        self.asked.append(f"drive {folder.name} with {len(model.model.effects)} effects")
        folder.mkdir()
        rms = 1e-3 if model.model.effects else 2e-3
        (folder / "summary.json").write_text(json.dumps({"mpc": {"errors": {"true": {"rms_m": rms}, "tracked": None}}}))


def closed(parts: Parts, folder: Path, monkeypatch: pytest.MonkeyPatch) -> model_update.ModelUpdate:
    for name in ("record", "run_discrepancy", "run_next", "run_closed_loop"):
        monkeypatch.setattr(model_update, name, getattr(parts, name))
    monkeypatch.setattr(model_update, "whole_reference", lambda *asked, **more: None)
    task = model_update.UpdateTask(MODEL, {"circle": circle()}, read_plan(PLAN))
    return model_update.run_model_update(task, RigSource("sim", lambda seed: None), folder)  # type: ignore[arg-type, return-value]


def test_named_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = Parts(["named"])
    done = closed(parts, tmp_path, monkeypatch)
    assert parts.asked == [
        "record data",
        "discrepancy data",
        "drive circle_nominal with 0 effects",
        "drive circle_corrected with 1 effects",
    ]
    assert done.ok
    assert (done.error("circle", "nominal"), done.error("circle", "corrected")) == (2e-3, 1e-3)
    assert json.loads((tmp_path / "summary.json").read_text())["close"]["status"] == ["named"]
    write_model_update_page(tmp_path / "closed.html", done)
    page = (tmp_path / "closed.html").read_text()
    for text in ("The missing effect is named", "payload", "0.99", "It carries something.", "circle"):
        assert text in page


def test_a_further_run_where_effects_cannot_be_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = Parts(["indistinguishable", "named"])
    done = closed(parts, tmp_path, monkeypatch)
    assert parts.asked[2:5] == ["next found_0", "record next_1", "discrepancy data next_1"]
    assert [verdict["status"] for verdict in done.verdicts] == ["indistinguishable", "named"]


@pytest.mark.slow
def test_not_for_ever_and_not_where_no_run_helps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    often = closed(Parts(["indistinguishable"] * 5), tmp_path / "often", monkeypatch)
    assert len(often.verdicts) == 1 + model_update.FURTHER
    assert not often.ok
    never = closed(Parts(["indistinguishable"] * 5, separable=False), tmp_path / "never", monkeypatch)
    assert len(never.verdicts) == 1


def test_what_is_finished_is_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    closed(Parts(["named"]), tmp_path, monkeypatch)
    again = Parts([])
    assert closed(again, tmp_path, monkeypatch).ok
    assert again.asked == ["record data"], "which keeps the runs that are there by itself"
