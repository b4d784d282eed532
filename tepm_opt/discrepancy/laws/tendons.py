"""Effects on a tendon's tension, or on the length it is pulled by, on its way to and along a body: in arrays."""

from __future__ import annotations

import numpy as np

from tepm_opt.discrepancy.laws.effect import At, Law, Quantity


def _limit_pull(at: At) -> tuple[np.ndarray, list[np.ndarray]]:
    """Limit the pull to a highest one, of which the parameter is the reciprocal: 0 means no limit."""
    return np.minimum(at.signal, at.sizes["signal"] / np.maximum(at.p["tightness"], 1e-9)), []


TENDONS = (
    Law(
        "tendon_slack", "input", (Quantity("slack", "signal", 0.0, (0.01, 0.1), 0.0, 1.0),),
        lambda at: (np.maximum(at.signal - at.p["slack"], 0.0), []),
        smooth=False, place="tendon", explains="a tendon carries no load until its slack, or the friction of its guide, is taken up",
        reference="Tao and Kokotović 1996, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, ch. 2",
    ),
    Law(
        "tendon_stretch", "input", (Quantity("share", "1", 0.0, (0.01, 0.1), 0.0, 0.9),),
        lambda at: ((1 - at.p["share"]) * at.signal, []),
        place="tendon", explains="a share of the pull stretches the tendon", reference="springs in series",
    ),
    Law(
        "tendon_slip", "input", (Quantity("tightness", "1", 0.0, (0.8, 1.0, 1.25, 1.6), 0.0, 10.0),), _limit_pull,
        smooth=False, place="tendon", explains="a tendon slips at its clamp: no more than so much arrives",
    ),
    Law(
        "capstan_friction", "input", (Quantity("friction", "1", 0.0, (0.02, 0.2), 0.0, 2.0),),
        lambda at: (at.signal * np.exp(-at.p["friction"] * at.turned), []),
        place="tendon", explains="friction along the bent body: the more it has turned, the less of the tension is left",
        reference="Eytelwein 1808: the tension goes as exp(-μ φ)",
    ),
)  # fmt: skip
"""Effects on a tendon; the signal is its tension or pull, `At.turned` the angle by which the body has bent from its base to there."""
