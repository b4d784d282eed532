"""Commands that take effect late."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Effect, Parameter


class TimeDelay(Effect):
    """All pressures and tensions act a fixed time after they were commanded; known forces act at once."""

    name = "time_delay"
    explains = "commands take effect late"
    reference = "pure transport delay; Åström and Murray, Feedback Systems, 2nd ed., section 9.2"
    parameters = (Parameter("delay", "s", null=0.0, probe=0.02, low=0.0, high=10.0),)
    further_probes = ({"delay": 0.3},)

    def delay(self, parameters: Mapping[str, ca.SX]) -> ca.SX:
        return parameters["delay"]
