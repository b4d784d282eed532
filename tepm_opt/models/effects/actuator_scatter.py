"""Muscles of which no two are alike."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter, Properties
from tepm_opt.models.effects.corners import no_less_than_nothing
from tepm_opt.models.layout import Layout


class ActuatorScatter(Effect):
    """Every muscle's pressure gives a share more force and, whatever it is, a constant force more, both about 0 with spreads of their own.

    One cause, a production's scatter, with two spreads; what each muscle has follows from them and the data. `gain_23` is the share of
    muscle 23, `offset_23` its constant force as the pressure that would make it, `one_sided` of all (see `actuator_offset`).
    """

    name = "actuator_scatter"
    explains = "gains and offsets of all muscles scatter"
    exact = True
    corners = True
    reference = "random effects; Gelman et al., Bayesian Data Analysis, 2013, ch. 5"

    def parameters_of(self, layout: Layout) -> tuple[Parameter, ...]:
        names = layout.actuator_names
        gains = (Parameter(f"gain_{name}", "1", null=0.0, probe=0.02, low=-1.0, high=1.0, spread="gain") for name in names)
        offsets = (Parameter(f"offset_{name}", "Pa", null=0.0, probe=-2e3, low=-1e6, high=1e6, spread="offset") for name in names)
        return (*gains, *offsets, Parameter("one_sided", "1", null=0.0, probe=0.0, low=0.0, high=1.0, change=0.2))

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        given = pressure * (1 + _each(parameters, "gain", context.layout))
        return no_less_than_nothing(given, _each(parameters, "offset", context.layout), parameters["one_sided"]), tension

    def properties(self, properties: Properties, parameters: Mapping[str, ca.SX], context: Context) -> None:
        properties.pressure = properties.pressure + _each(parameters, "offset", context.layout)


def _each(parameters: Mapping[str, ca.SX], kind: str, layout: Layout) -> ca.SX:
    """A parameter of every muscle, (modules, actuators)."""
    values = ca.vertcat(*(parameters[f"{kind}_{name}"] for name in layout.actuator_names))
    return ca.reshape(values, layout.actuators, layout.modules).T
