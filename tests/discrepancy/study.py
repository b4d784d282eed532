"""How well the workflow does on data sets whose hidden effects are known.

`python -m tests.discrepancy.study FOLDER [NAME …]` explains FOLDER/NAME for every FOLDER/labels/NAME.json and prints a line each: what
is hidden, what was named, how the gap shrinks, whether sizes are recovered.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tepm_opt.discrepancy.assessment.result import Verdict, VerdictStatus
from tepm_opt.jobs.discrepancy import run_discrepancy
from tepm_opt.models.effects import effects


@dataclass(frozen=True)
class Answer:
    """A verdict beside the truth.

    Attributes:
        truth: names of the hidden effects; those foreign to SPEC's vocabulary are no effect's name.
        detail: by name, which actuator or point.
        sizes: true parameters by full name, as far as they are known in the model's terms.
        verdict: the workflow's.
    """

    truth: tuple[str, ...]
    detail: Mapping[str, str]
    sizes: Mapping[str, float]
    verdict: Verdict

    @property
    def named(self) -> dict[str, str | None]:
        """Detail by name of the effects named with a probability of at least one half."""
        return {each.candidate.name: each.candidate.detail for each in self.verdict.effects if each.probability >= 0.5}

    @property
    def foreign(self) -> bool:
        """Whether something outside the vocabulary is hidden."""
        return bool(set(self.truth) - {effect.name for effect in effects()})

    @property
    def right(self) -> bool:
        """Whether everything hidden is named with its detail, nothing else is, and what has no name is not named."""
        if self.foreign:
            return self.verdict.status is VerdictStatus.UNEXPLAINED or not self.named
        if not self.truth:
            return self.verdict.status is VerdictStatus.NO_DISCREPANCY
        expected = {name: self.detail.get(name) for name in self.truth}
        return self.verdict.status is VerdictStatus.NAMED and self.named == expected

    @property
    def recovered(self) -> dict[str, bool]:
        """Whether each true size is inside its 95 % interval or within 10 %; one that is not among what was named is not."""
        found = {f"{each.candidate.label}.{name}": value for each in self.verdict.effects for name, value in each.parameters.items()}
        return {
            name: name in found and abs(found[name].value - true) <= max(1.96 * found[name].std, 0.1 * abs(true))
            for name, true in self.sizes.items()
        }

    def line(self, name: str) -> str:
        """One line for people."""
        errors, verdict = self.verdict.errors, self.verdict
        said = " + ".join(f"{e.candidate.label} {e.probability:.2f}" for e in verdict.effects) or "-"
        hidden = " + ".join(f"{n}[{self.detail[n]}]" if n in self.detail else n for n in self.truth) or "nothing"
        sizes = ", ".join(f"{size} {'in' if ok else 'OUT'}" for size, ok in self.recovered.items())
        return (
            f"{'ok   ' if self.right else 'WRONG'} {name}: {hidden} -> {verdict.status.value}: {said}; "
            f"closed {errors.gap_closed_fraction:.3f}, "
            f"corrected / floor {errors.corrected / errors.noise_floor:.2f}, {verdict.seconds:.0f} s; {sizes}"
        )


def examine(folder: Path, label: Mapping[str, Any], out: Path) -> Answer:
    """Explain a data set and set the verdict beside its label."""
    result = run_discrepancy(folder, out)
    sizes = {name: value for name, value in label["sizes"].items() if isinstance(value, float | int)}
    return Answer(tuple(label["names"]), dict(label["detail"]), sizes or known_sizes(label), result.verdict)


def known_sizes(label: Mapping[str, Any]) -> dict[str, float]:
    """Sizes in the model's terms from a label that has them in its simulator's."""
    found: dict[str, float] = {}
    for name, own in label["sizes"].items():
        detail = label["detail"].get(name)
        owner = f"{name}[{detail}]" if detail else name
        for kind, value in own.items():
            for full, number in TERMS.get((name, kind), lambda value: {})(value).items():
                found[f"{owner}.{full}"] = number
    return found


def _vector(name: str) -> Any:
    return lambda value: {f"{name}_{axis}": number for axis, number in zip("xyz", value, strict=True)}


TERMS: dict[tuple[str, str], Any] = {
    ("payload", "m"): lambda value: {"mass": value},
    ("pressure_dead_zone", "p0"): lambda value: {"threshold": value},
    ("regulator_lag", "fill"): lambda value: {"filling_time": value},
    ("regulator_lag", "exhaust"): lambda value: {"exhausting_time": value},
    ("actuator_gain", "loss"): lambda value: {"loss": value},
    ("sensor_misalignment", "shift"): _vector("shift"),
    ("sensor_misalignment", "rotvec"): _vector("rotation"),
    ("base_tilt", "ax"): lambda value: {"y": value},  # gravity's components along x and y, over g
    ("base_tilt", "ay"): lambda value: {"x": -value},
    ("tendon_friction", "f0"): lambda value: {"constant": value},
    ("tendon_friction", "mu"): lambda value: {"share": value},
}


def main() -> None:
    """Print a line for every labelled data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", help="only these")
    options = parser.parse_args()
    names = options.names or sorted(path.stem for path in (options.folder / "labels").glob("*.json"))
    right = []
    for name in names:
        label = json.loads((options.folder / "labels" / f"{name}.json").read_text(encoding="utf-8"))
        with tempfile.TemporaryDirectory() as out:
            answer = examine(options.folder / name, label, Path(out))
        right.append(answer.right)
        print(answer.line(name), flush=True)
    print(f"{sum(right)} of {len(right)} right")


if __name__ == "__main__":
    main()
