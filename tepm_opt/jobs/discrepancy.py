"""The workflow on a folder: check the data, find what is missing, write the answer."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.control.estimation.filter_tuning import settings_of_explained
from tepm_opt.control.mpc.settings import MpcSettings
from tepm_opt.data.checks.dataset import check_reading
from tepm_opt.data.checks.findings import Finding
from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.data.documents import read_json
from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.noise import noise_of
from tepm_opt.data.trials import Trials, read_trials
from tepm_opt.discrepancy.adapters.cost import measure_cost
from tepm_opt.discrepancy.adapters.network import SearchableNetwork
from tepm_opt.discrepancy.assessment.result import Verdict, VerdictStatus
from tepm_opt.discrepancy.pipeline import DiscoverOptions, discover, require_fit_runs
from tepm_opt.discrepancy.problem.plant import SearchablePlant
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.problem.time_limit import TimeLimit
from tepm_opt.discrepancy.reporting.effect_table import effect_table, sentences_beside_table
from tepm_opt.discrepancy.setup.errors import mend_runs
from tepm_opt.discrepancy.state import Discovery, Question
from tepm_opt.discrepancy.symbolic.invent import Invention
from tepm_opt.discrepancy.symbolic.invent import invent as invented
from tepm_opt.discrepancy.symbolic.page import as_json, curves, page
from tepm_opt.errors import InputError
from tepm_opt.jobs.advice import MENDED, MODEL, VALUES, Asked, add_advice
from tepm_opt.jobs.baseline import BaselineFile, fingerprint
from tepm_opt.jobs.joined import concatenate_datasets
from tepm_opt.jobs.plants import load_plant
from tepm_opt.models.channels import channels_of, read
from tepm_opt.models.effect_files import loaded_effects, loaded_files
from tepm_opt.models.effects import find_effect
from tepm_opt.models.model import Model, read_model, write_model
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.mechanics.plant import PredictionError

VERDICT, FITS, EFFECTS = "verdict.json", ".fits.json", "effects"
PULLS = 0.01  # of a motor's range: tension from which it pulls
SURE = 0.25  # standard deviation over the value, up to which the travel of a friction is known


def checked_dataset(folder: Path, despite_errors: bool = False, mends_setup: bool = False) -> tuple[DataSet, list[str]]:
    """A data set, read once, and the warnings of its check, one line each.

    Args:
        folder: of the data set.
        despite_errors: whether to take it without a check, as long as it can be used at all; there are no warnings then.
        mends_setup: whether errors of the set-up, which most runs have, are left to the caller, where there are no others.

    Raises:
        InputError: the data cannot be used, or the check finds errors; the first few stand in the message.
    """
    reading = read(folder)
    if despite_errors:
        return reading.usable, []
    findings = check_reading(reading)
    lines = {kind: [_line(f) for f in findings if f.severity == kind] for kind in ("error", "warning")}
    if mends_setup and _of_whole_setup([f for f in findings if f.severity == "error"], len(reading.listed)):
        return reading.usable, lines["warning"]
    if errors := lines["error"]:
        more = f" (and {len(errors) - 3} more errors: tepm data check {folder})" if len(errors) > 3 else ""
        raise InputError(f"{folder}: {'; '.join(errors[:3])}{more}. An answer from such data would mislead")
    return reading.usable, lines["warning"]


def _of_whole_setup(errors: Sequence[Finding], runs: int) -> bool:
    """Whether all errors are of the set-up and in more than half of the runs; what one recording has is for its file to mend."""
    files = {channel: {f.file for f in errors if f.channel == channel} for channel in {f.channel for f in errors}}
    return all(f.is_setup for f in errors) and all(2 * len(those) > runs for those in files.values())


@dataclass(frozen=True)
class DiscrepancyOptions:
    """Options of an explanation of a data set.

    Attributes:
        seed: of all random draws.
        despite_errors: whether to go on where the check of the data finds errors.
        invent: whether to seek a law where no known effect explains what is left; its effect file, page and model go into `effects`.
        add: data sets of the same machine that were recorded later, see `concatenate_datasets`.
        mend: whether to write the data without their set-up errors into `mended`.
        baseline: an earlier data set of the same machine: the answer tells what changed since; what it says of the parameters and of the
            model's error goes into `baseline.json`. Or such a file, so that nothing is learned anew.
        minutes: that the search may take; None for no limit. What was fitted is kept then, and the same command goes on from there.
    """

    seed: int = 0
    despite_errors: bool = False
    invent: bool = False
    add: Sequence[str | Path] = ()
    mend: bool = False
    baseline: str | Path | None = None
    minutes: float | None = None


def run_discrepancy(
    folder: str | Path, out: str | Path, model: str | Path | None = None, plant: str | Path | None = None,
    options: DiscrepancyOptions | None = None, progress: Progress = silent,
) -> Discovery:  # fmt: skip
    """Explain a data set; write `verdict.json` and `model.toml` into a folder, or `values.json` where a plant file gives the machine.

    What was fitted is kept in the folder while the search runs: the same command after an interruption goes on where it was.

    Args:
        folder: data set.
        out: for the results.
        model: model file; the robot that the data set names where absent.
        plant: Python file of another machine, which the data set is of.
        options: of the search.
        progress: told of every piece of work.

    Raises:
        InputError: data or model cannot be used; the message says why.
    """
    folder, out, options = Path(folder), Path(out), options or DiscrepancyOptions()
    limit, earlier = _time_limit(options.minutes), Path(options.baseline) if options.baseline else None
    if plant is not None and options.add:
        raise InputError("--add and --plant exclude each other; valid: data sets of a robot")
    if plant is not None and options.mend:
        raise InputError("--mend and --plant exclude each other; valid: data sets of a robot")
    if plant is not None:
        return _explain_plant(Asked(folder, out, plant=Path(plant), baseline=earlier), Path(plant), options.seed, limit, progress)
    asked = Asked(
        folder, out, Path(model) if model else None, add=tuple(map(Path, options.add)), invent=options.invent,
        despite_errors=options.despite_errors, effects=loaded_files(), mend=options.mend, baseline=earlier,
    )  # fmt: skip
    return _explain_robot(asked, options.seed, limit, progress)


def _explain_robot(asked: Asked, seed: int, limit: TimeLimit, progress: Progress) -> Discovery:
    """Explain data sets of a robot, see `run_discrepancy`.

    Args:
        asked: arguments of the command.
        seed: of all random draws.
        limit: of the search.
        progress: told of every piece of work.
    """
    folders, model = [asked.folder, *asked.add], asked.model
    dataset, warnings = checked_datasets(folders, asked.despite_errors, mends_setup=True)
    known = read_model(model) if model else Model.from_robot(dataset.robot)
    channels = channels_of(known.robot)
    if channels.columns != dataset.channels.columns:
        raise InputError(f"{model}: its robot has other actuators or reference points than {dataset.robot}, which {asked.folder} names")
    out = output_folder(asked.out)
    noise = noise_of(dataset)
    require_fit_runs(dataset)
    progress("compiling a model with all effects at their null values", 0, 0)
    network = SearchableNetwork.from_model(known, channels, dataset.static)
    machine = (known.robot.model_dump_json(), str(known.values), loaded_effects())
    key, earlier = fingerprint(folders, *machine, str(seed)), None
    if asked.baseline is not None:
        source = BaselineFile.open(asked.baseline)
        old, more_warnings = checked_dataset(source.folder, asked.despite_errors, mends_setup=True)
        warnings = [*warnings, *more_warnings]
        question = Question(old, network, noise_of(old), SearchSettings.for_plant(network), seed, progress=progress)
        earlier, key = source.learn(question, machine, out), fingerprint([source.folder], key)
    options = DiscoverOptions(seed, store=out / FITS, key=key, limit=limit)
    result = discover(dataset, network, noise, earlier, options, progress)
    if not result.verdict.setup:
        checked_datasets(folders, asked.despite_errors)  # refuses errors of the set-up that the workflow did not find
    explained = not result.verdict.setup and result.verdict.status is not VerdictStatus.UNEXPLAINED
    best = result.verdict.model
    write_model(settings_of_explained(best, find_travel(result.verdict, dataset)) if explained else best, out / MODEL)
    if asked.mend and result.verdict.setup:
        write_dataset(dataset.with_runs(mend_runs(dataset.runs, result.verdict.setup)), out / MENDED, overwrite=True)
    if asked.invent and result.verdict.status in (VerdictStatus.UNEXPLAINED, VerdictStatus.PARTIAL):
        result = replace(result, law=with_law(result, out / EFFECTS, progress))
    result = add_advice(result, replace(asked, ended_early=limit.was_short))
    _write(result, out, warnings, limit, {"data": [_seen_from(out, each) for each in folders], "model": _seen_from(out, model)})
    return result


def find_travel(verdict: Verdict, dataset: DataSet) -> float | None:
    """Distance in m over which friction of the tendons turns over in closed loop, where a verdict tells it; None elsewhere.

    A verdict has it at the tension of the data. Bristles of constant stiffness bend in proportion to the friction, which is in proportion
    to the tension (Dahl, A solid friction model, Aerospace Corp. TOR-158, 1968).
    """
    most, acting = verdict.model.robot.input_max, [effect.label for effect in verdict.model.effects]
    tensions = np.concatenate([run.inputs[:, len(most) // 2 :].ravel() for run in dataset.runs])
    pulled = tensions[tensions > PULLS * most[-1]]
    for named in verdict.effects if len(pulled) else ():
        values = {name: value.value for name, value in named.parameters.items()}
        name = find_effect(named.candidate.name).friction_travel(values) if named.candidate.label in acting else None
        if name is not None and 0 < named.parameters[name].std <= SURE * values[name]:
            return values[name] * MpcSettings().mid_range * float(most[-1] / np.sqrt(np.mean(pulled**2)))
    return None


def _explain_plant(asked: Asked, file: Path, seed: int, limit: TimeLimit, progress: Progress) -> Discovery:
    """Explain a data set of a plant file's machine, see `run_discrepancy`.

    Args:
        asked: arguments of the command.
        file: with the plant.
        seed: of all random draws.
        limit: of the search.
        progress: told of every piece of work.
    """
    plant = load_plant(file)
    dataset = read_trials(asked.folder, plant.signals, plant.static)
    require_fit_runs(dataset)
    out = output_folder(asked.out)
    operations = getattr(plant, "operations", 0)  # of equations
    progress(f"{plant.name}: building derivatives" + (f" of {operations} operations" if operations else ""), 0, 0)
    if cost := measure_cost(plant, dataset.fit):
        progress(f"{plant.name}: {cost.sentence}", 0, 0)
    # it may import files beside it
    machine = (file.name, *(path.read_text(encoding="utf-8", errors="replace") for path in sorted(file.parent.glob("*.py"))))
    key, earlier = fingerprint([asked.folder], *machine, str(seed)), None
    if asked.baseline is not None:
        source = BaselineFile.open(asked.baseline)
        old = read_trials(source.folder, plant.signals, plant.static)
        question = Question(old, plant, _noise(old, plant), SearchSettings.for_plant(plant), seed, progress=progress)
        earlier, key = source.learn(question, machine, out), fingerprint([source.folder], key)
    options = DiscoverOptions(seed, store=out / FITS, key=key, limit=limit)
    result = discover(dataset, plant, _noise(dataset, plant), earlier, options, progress)
    write_atomically(out / VALUES, json.dumps(result.verdict.model, indent=2) + "\n")
    result = add_advice(result, replace(asked, ended_early=limit.was_short))
    _write(result, out, [], limit)
    return result


def read_verdict(folder: str | Path) -> Mapping[str, Any]:
    """Content of the verdict.json in a folder.

    Raises:
        InputError: it is not there, or damaged.
    """
    path = Path(folder) / VERDICT
    if not path.is_file():
        raise InputError(f"{path} is not there; valid: the folder that tepm discrepancy wrote (--out)")
    return read_json(path, "tepm discrepancy")


def _seen_from(out: Path, path: str | Path | None) -> str | None:
    """A path as seen from the folder of the results."""
    return None if path is None else Path(os.path.relpath(path, out)).as_posix()


def _line(finding: Finding) -> str:
    """A finding of the check of data in a line."""
    return f"{finding.file}: {finding.channel + ': ' if finding.channel else ''}{finding.message}"


def checked_datasets(folders: Sequence[Path], despite_errors: bool = False, mends_setup: bool = False) -> tuple[DataSet, list[str]]:
    """Data sets of one machine as one, and the warnings of their checks; see `checked_dataset` and `concatenate_datasets`.

    Raises:
        InputError: one of them cannot be used, or they do not fit together.
    """
    (first, warnings), *others = (checked_dataset(folder, despite_errors, mends_setup) for folder in folders)
    lines = [f"{folder.name}/{line}" for folder, (_, own) in zip(folders[1:], others, strict=True) for line in own]
    return concatenate_datasets(first, [(folder, found) for folder, (found, _) in zip(folders[1:], others, strict=True)]), [
        *warnings,
        *lines,
    ]


def with_law(result: Discovery, folder: Path, progress: Progress = silent) -> Invention | None:
    """A law for what a verdict leaves, with its effect file, its model and its page in a folder; None where there is none.

    Args:
        result: of a robot's network.
        folder: is made where something is found.
        progress: told of every piece of work.
    """
    best, known = result.explanation.best.estimate, result.verdict.model
    names = {*known.robot.parameters.model_dump(), *(f"{effect.label}.{name}" for effect in known.effects for name in effect.parameters)}
    if not isinstance(best.plant, SearchableNetwork) or not {f.name for f in best.problem.free} <= names:
        best = result.explanation.without.estimate  # what holds in some runs only is in no model
        known = best.plant.corrected_model(())  # type: ignore[attr-defined]
    try:
        law = invented(best, known, folder, result.dataset.name, result.dataset.validation, progress)
    except PredictionError:
        return None
    if law is not None:
        write_model(law.model, law.file.with_suffix(".toml"))
        write_atomically(law.file.with_suffix(".md"), page(law, f"{law.written.name}.png" if curves(law) else None))
    return law


def _noise(dataset: Trials, plant: SearchablePlant) -> float | np.ndarray:
    """Noise of a plant's data: one number where all outputs have the same, in the same unit, else that of each, (outputs, 1)."""
    return float(dataset.noise[0, 0]) if plant.signals.unit and np.ptp(dataset.noise) == 0 else dataset.noise


def _time_limit(minutes: float | None) -> TimeLimit:
    """The limit of a search.

    Raises:
        InputError: not a positive number.
    """
    if minutes is not None and not minutes > 0:
        raise InputError(f"--minutes: {minutes:g} is no time to search; valid: above 0, such as 10")
    return TimeLimit() if minutes is None else TimeLimit(minutes)


def _write(result: Discovery, out: Path, warnings: Sequence[str], limit: TimeLimit, origin: Mapping[str, Any] | None = None) -> None:
    """Write `verdict.json`, with what it is about; kept fits go, unless there were others for which time was short."""
    head, rows = effect_table(result.verdict)
    said = [*result.verdict.setup_sentences, *sentences_beside_table(result.verdict, result.localisation.sentence)]
    content = result.verdict.as_json() | {"table": [head, *rows] if rows else [], "answer": " ".join(said)} | dict(origin or {})
    if result.law is not None:
        content["law"] = as_json(result.law)
    content["notes"] += [f"data: {line}" for line in warnings]
    write_atomically(out / VERDICT, json.dumps(content, indent=2) + "\n")
    for kept in () if limit.was_short else out.glob(f"{FITS}*"):
        kept.unlink()
