"""A page an effect, from the effect itself: its words, its equations, its parameters, and what it does in a simulated motion."""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from docs.site.equations import Hooks
from tepm_opt import compile_model, simulate
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.effect import ActiveEffect, Effect
from tepm_opt.models.effects import effects
from tepm_opt.models.layout import Layout
from tepm_opt.models.model import Model
from tepm_opt.plots.palette import CORRECTED, NOMINAL

ALIKE = 0.9
"""Cosine from which two effects are called alike in the motion of these pages."""
DETAILS = {"actuator": "actuator", "point": "reference point"}
BEGAN = 20.0
"""Time in the session at which that motion begins, in s: what drifts has drifted by then."""

INDEX = """# Effects

Physical effects that a model can be given beside the network of [the theory](../explanation/theory.md), and that a verdict can name.
Each page is made from the effect itself when the site is built: its words, the equations that its code computes,
its parameters with the values at which it vanishes, and what it does to a motion of the robot `kang2017`.

How to read them: primes mark what an effect makes of something; $p_{hj}$ is the pressure and $\\lambda_{hj}$ the tension of actuator $j$ of
module $h$, $\\ell$ the length of a muscle's segment and $\\ell_0$ its rest length, $k$, $c$ and $m$ stiffness, damping and mass,
$F$ a force on a level in the base's frame, $t$ the time in the session and $t_0$ when the run began. An effect that acts on one
actuator or reference point is shown on the third. A memory $y$ is a state of its own. What is longer than a
line is left to the words and to the code.

The motion lasts 6 s: four muscles are filled, two tendons pulled, then all of it is let go. *Looks like* compares, over all four reference
points, what effects add to it: 1.00 means that this motion cannot tell them apart (others may), and no number says that about your data:
a verdict's own rivals do, see [how to find out what is missing](../how-to/discrepancy.md).

| effect | what it explains | moves the tip by (mm) | looks like |
| --- | --- | --- | --- |
"""


@dataclass(frozen=True)
class Seen:
    """What an effect at its probe values adds to the motion.

    Attributes:
        time: (samples,) in s.
        tip, nominal: tip with and without it in G, (samples, 3) in m.
        moved: change of all reference points, (samples, points, 3) in m.
    """

    time: np.ndarray
    tip: np.ndarray
    nominal: np.ndarray
    moved: np.ndarray

    @cached_property
    def rms(self) -> np.ndarray:
        """Root mean square change of each reference point in m."""
        return np.sqrt(np.mean(np.sum(self.moved**2, axis=2), axis=0))

    def like(self, other: Seen) -> float:
        """Cosine between what two effects add, without its sign."""
        sizes = np.linalg.norm(self.moved) * np.linalg.norm(other.moved)
        return abs(float(np.sum(self.moved * other.moved))) / sizes if sizes else 0.0


def names() -> list[str]:
    """All effects' names."""
    return [effect.name for effect in effects()]


def motion() -> SetPoints:
    """The motion that the pages show."""
    time = np.arange(0.0, 6.0001, 0.02)
    filled = np.interp(time, [0, 0.5, 1.5, 3.5, 4.5, 6], [0, 0, 1, 1, 0, 0])
    pulled = np.interp(time, [0, 1, 2, 4, 5, 6], [0, 0, 1, 1, 0, 0])
    most = np.array([80e3, 20e3, 120e3, 20e3, 60e3, 0.0, 0.0, 1.0, 2.0, 0.0, 0.0, 1.0])
    return SetPoints(time, np.where(np.arange(12) < 6, filled[:, None], pulled[:, None]) * most, np.zeros((len(time), 3)))


def observed() -> dict[str, Seen]:
    """The motion with each effect, by name. One model has them all, at their null values but for one: it is compiled once."""
    model = Model.from_robot("kang2017")
    layout = Layout.from_robot(model.robot)
    for effect in effects():
        details = layout.details(effect.detail)
        null = {parameter.name: parameter.null for parameter in effect.parameters_of(layout)}
        model = model.with_effect(effect.name, details[min(2, len(details) - 1)] if details else None, **null)
    compiled, setpoints = compile_model(model), motion()
    nominal = simulate(compiled, setpoints, began=BEGAN).complete().points
    found = {}
    for active, effect in zip(model.effects, effects(), strict=True):
        theta = [_probe(name, value, active, effect, layout) for name, value in compiled.values.items()]
        run = simulate(compiled.with_theta([*theta, *compiled.theta[len(theta) :]]), setpoints, began=BEGAN).complete()
        found[effect.name] = Seen(setpoints.time, run.tip, nominal[:, -1], run.points - nominal)
    return found


def _probe(name: str, value: float, active: ActiveEffect, effect: Effect, layout: Layout) -> float:
    probes = {f"{active.label}.{parameter.name}": parameter.probe for parameter in effect.parameters_of(layout)}
    return probes.get(name, value)


def pages() -> dict[str, str | bytes]:
    """All pages and figures by their paths."""
    seen = observed()
    made: dict[str, str | bytes] = {"effects/index.md": INDEX}
    rows = []
    for effect in effects():
        like = _rivals(effect.name, seen)
        links = ", ".join(f"[{name}]({name}.md) {cosine:.2f}" for name, cosine in like)
        rows.append(f"| [{effect.name}]({effect.name}.md) | {effect.explains} | {1e3 * seen[effect.name].rms[-1]:.2g} | {links} |")
        made[f"effects/{effect.name}.md"] = _page(effect, seen[effect.name], links)
        made[f"effects/{effect.name}.png"] = _figure(seen[effect.name])
    listed = "\n".join(names())
    made["effects/index.md"] = f"{INDEX}{chr(10).join(rows)}\n\n```{{toctree}}\n:hidden:\n\n{listed}\n```\n"
    return made


def _rivals(name: str, seen: dict[str, Seen]) -> list[tuple[str, float]]:
    """The three effects that look most like one, those alike."""
    cosines = [(other, seen[name].like(seen[other])) for other in seen if other != name]
    return sorted((each for each in cosines if each[1] >= ALIKE), key=lambda each: -each[1])[:3]


def _page(effect: Effect, seen: Seen, like: str) -> str:
    model = Model.from_robot("kang2017")
    layout = Layout.from_robot(model.robot)
    acts = f" Acts on one {DETAILS[effect.detail]}, which a verdict names." if effect.detail else ""
    text = [f"# {effect.name}", "", f"{effect.explains[0].upper()}{effect.explains[1:]}.{acts}", ""]
    text += ["## Physics", "", inspect.cleandoc(type(effect).__doc__ or ""), "", f"Reference: {effect.reference}.", ""]
    shown = list(Hooks(effect, model).equations())
    text += ["## Equations", ""]
    for words, equation in shown:
        text += [f"{words[0].upper()}{words[1:]}:", "", f"$$\n{equation}\n$$", ""] if equation else []
    left_out = sorted({words for words, equation in shown if not equation})
    if left_out or not shown:
        told = f" ({', '.join(left_out)})" if left_out else ""
        text += [f"What is too long for a line{told} stands in `tepm_opt/models/effects/{effect.name}.py`.", ""]
    text += ["## Parameters", "", "| parameter | unit | null | probe | range |", "| --- | --- | --- | --- | --- |"]
    for each in effect.parameters_of(layout):
        kind = " (shape)" if each.is_shape else ""
        text.append(f"| `{each.name}`{kind} | {each.unit} | {each.null:g} | {each.probe:g} | {each.low:g} … {each.high:g} |")
    text += [
        "",
        "At its null values the effect vanishes; a shape parameter says how it acts, not how strongly. A probe is small but visible.",
        "",
    ]
    rms = ", ".join(f"s_{k + 1} {1e3 * value:.2g}" for k, value in enumerate(seen.rms))
    text += ["## What it does to data", "", f"![Tip with and without it over the motion, and what it adds]({effect.name}.png)", ""]
    text += [f"At its probe values it moves the reference points of `kang2017` by (root mean square, mm): {rms}.", ""]
    text += ["## Rivals", "", f"In this motion it looks like {like}." if like else "In this motion nothing else looks like it.", ""]
    return re.sub(r"(?<!`)\|y\|", r"\\|y\\|", "\n".join(text))


def _figure(seen: Seen) -> bytes:
    """Tip with and without the effect along each axis, and the difference below."""
    figure = Figure(figsize=(9.0, 4.2), dpi=110, layout="constrained")
    above, below = figure.subplots(2, 3, sharex=True)
    for axis, (top, bottom) in enumerate(zip(above, below, strict=True)):
        top.plot(seen.time, 1e3 * seen.tip[:, axis], **CORRECTED.lined, label="with")
        top.plot(seen.time, 1e3 * seen.nominal[:, axis], **NOMINAL.lined, label="without")
        top.set_title(f"tip, {'xyz'[axis]} (mm)", fontsize=10)
        bottom.plot(seen.time, 1e3 * (seen.tip - seen.nominal)[:, axis], color="black")
        bottom.set_title("with less without (mm)", fontsize=10)
        bottom.set_xlabel("time (s)")
        for panel in (top, bottom):
            panel.grid(alpha=0.3)
    above[0].legend(fontsize=9)
    buffer = BytesIO()
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()
