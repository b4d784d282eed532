"""Texts of effect files."""

from __future__ import annotations

from collections.abc import Mapping

TEXTS: Mapping[str, str] = {
    "file": '''"""{explains}: a law found in {source}. Rename it when you know what it is; the page beside it says how well it does."""

from __future__ import annotations

import casadi as ca

from tepm_opt.models.effect import {imports}
{more}
{at}{helpers}class {kind}(Effect):
    """{explains}."""

    name = "{name}"
    explains = "{explains}"
    reference = "found by tepm discrepancy --invent in {source}"
    parameters = (
{parameters}    )

{law}{hook}''',
    "ramp": '''def ramp(x):
    """max(x, 0) with a rounded corner."""
    return (x + ca.sqrt(x**2 + 0.02**2)) / 2


''',
    "ramp_integral": '''def ramp_integral(x):
    """Twice the integral of a ramp with a rounded corner."""
    return (x**2 + x * ca.sqrt(x**2 + 0.02**2) + 0.02**2 * ca.asinh(x / 0.02)) / 2


''',
    "law": """    def law(self, z, parameters):
        return {sum}

""",
    "input_hook": """    def inputs(self, pressure, tension, parameters, context):
        changed = ca.SX({which})
        for k in {each}:
            at = divmod(k, context.layout.actuators)
            changed[at] += self.law({z}, parameters){times}
        return {result}
""",
    "length_law": '''    def law(self, z, parameters):
        """Integral of the force over the stretch z of a muscle."""
        return {sum}

''',
    "length_hook": """    def edge_energy(self, edge, length, rest, parameters, context):
        if edge.kind != VERTICAL:
            return ca.SX(0)
        segments = context.layout.segments
        return (self.law(0.0, parameters) - self.law(segments * (length - rest), parameters)) / segments
""",
    "rate_hook": """    def edge_drag(self, edge, length, rate, parameters, context):
        return -self.law(context.layout.segments * rate, parameters) if edge.kind == VERTICAL else ca.SX(0)
""",
    "chosen": '''    def mask_actuators(self, state):
        """1 where the law acts."""
        found = ca.DM.zeros(*state.shape)
        for k in AT:
            found[divmod(k, state.shape[1])] = 1
        return found

''',
    "lag": """    def {which}_memory(self, {which}, rate, state, parameters, context):
        return Memory(-parameters["share"] * {chosen} * rate, ca.DM.ones(*state.shape), parameters["time"] * ca.DM.ones(*state.shape))
""",
    "play": """    def {which}_memory(self, {which}, rate, state, parameters, context):
        return Memory(-parameters["share"] * {chosen} * rate, ca.fabs(rate), parameters["distance"] * ca.DM.ones(*state.shape))
""",
    "edge_lag": """    def edge_memory(self, edge, length, rate, properties, parameters, context):
        if edge.kind != VERTICAL:
            return None
        return Memory(parameters["share"] * context.layout.segments * rate, ca.SX(1), parameters["time"])
""",
    "edge_play": """    def edge_memory(self, edge, length, rate, properties, parameters, context):
        if edge.kind != VERTICAL:
            return None
        distance = parameters["distance"] / context.layout.segments  # an actuator's, shared by its segments
        return Memory(parameters["share"] * context.layout.segments * rate, ca.fabs(rate), distance)
""",
    "stiffening": """    def properties(self, properties, parameters, context):
        layout = context.layout
        for segment in range(layout.levels):
            for j in range(layout.actuators):
                pressure = properties.pressure[segment // layout.segments, j]
                properties.stiffness[j, segment] += layout.segments * parameters["per_pressure"] * pressure
""",
    "force_law": '''    def law(self, position, parameters):
        """Integrals of the force's components over the coordinates."""
        return (
            {x}
            + {y}
            + {z}
        )

''',
    "force_hook": """    def point_energy(self, point, position, parameters, context):
        return -self.law(position, parameters) if point in AT else ca.SX(0)
""",
    "drag_hook": """    def point_drag(self, point, position, velocity, parameters, context):
        speed = ca.sqrt(ca.sumsqr(velocity) + 1e-9)
        return -({sum}) * velocity if point in AT else ca.SX.zeros(3)
""",
    "load_hook": """    def loads(self, properties, external, parameters, context):
        force = ca.mtimes(ca.DM(context.rotation.T), ca.vertcat({sum}))
        return ca.mtimes(force, ca.DM(context.layout.point_weights[AT[0] : AT[0] + 1, 1:]))
""",
    "seen_law": """    def law(self, x, y, z, parameters):
        return ca.vertcat(
            {x},
            {y},
            {z},
        )

""",
    "seen_hook": """    def outputs(self, points, parameters, context):
        measured = ca.SX(points)
        for k in AT:
            measured[:, k] += self.law(*ca.vertsplit(points[:, k]), parameters)
        return measured
""",
}
"""By name: parts of a file, laws and hooks of `models.effect.Effect`, with the fields that `writing` fills in."""
