"""A model with all effects that have internal states or a delay; compiled once, as only values differ."""

from __future__ import annotations

from tepm_opt.models.model import Model

WITHOUT = {
    "structural_friction": {"force": 0.0, "distance": 1e-3},
    "creep": {"share": 0.0, "relaxation_time": 1.0},
    "regulator_lag": {"filling_time": 1e-3, "exhausting_time": 1e-3},
    "time_delay": {"delay": 0.0},
    "pressure_hysteresis": {"width": 0.0, "distance": 2e4},
}


def with_dynamics(**effects: dict[str, float]) -> Model:
    """kang2017 with these effects; the others are there without showing."""
    model = Model.from_robot("kang2017")
    for name, parameters in WITHOUT.items():
        model = model.with_effect(name, **effects.get(name, parameters))
    return model
