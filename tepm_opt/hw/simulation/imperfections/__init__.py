"""Everything that keeps a rig from being its model, each part off unless a rig file says otherwise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, ClassVar

from pydantic import Field

from tepm_opt.data.documents import Section, require_range
from tepm_opt.hw.simulation.imperfections.around import TetheredTip, TipDrag, TipWall
from tepm_opt.hw.simulation.imperfections.base import Imperfection
from tepm_opt.hw.simulation.imperfections.body import (
    BaseTilt,
    ExternalLoad,
    MassDistribution,
    Payload,
    RigidPlates,
    SoftPart,
    TwistedBody,
    UnevenMass,
)
from tepm_opt.hw.simulation.imperfections.edges import Creep, StiffnessHardening, StructuralFriction
from tepm_opt.hw.simulation.imperfections.pressure import (
    ActuatorGain,
    PressureCrosstalk,
    PressureDeadZone,
    PressureHysteresis,
    RegulatorLag,
)
from tepm_opt.hw.simulation.imperfections.sensing import FieldDistortion, SensorMisalignment, SensorOffset
from tepm_opt.hw.simulation.imperfections.session import BaseVibration, ClockSkew, SampleJitter, TendonSlip, TrackerDrift, WarmUp
from tepm_opt.hw.simulation.imperfections.tendon import TendonFriction, TendonSlack
from tepm_opt.hw.simulation.imperfections.unlike import ActuatorOffset, ActuatorScatter, TensionGain
from tepm_opt.hw.simulation.imperfections.valves import ChokedFilling, RegulatorLeak


class TimeDelay(Imperfection):
    """Commands take effect late, all by the same time."""

    of_one_actuator: ClassVar[bool] = True
    of_devices: ClassVar[bool] = True
    delay_s: Annotated[float, require_range(0, 10, "s")] = 0.0


class Imperfections(Section):
    """All imperfections of a rig, in the order in which they act: those of SPEC section 5 and some more."""

    time_delay: TimeDelay = Field(default_factory=TimeDelay)
    regulator_lag: RegulatorLag = Field(default_factory=RegulatorLag)
    choked_filling: ChokedFilling = Field(default_factory=ChokedFilling)
    regulator_leak: RegulatorLeak = Field(default_factory=RegulatorLeak)
    actuator_offset: ActuatorOffset = Field(default_factory=ActuatorOffset)
    pressure_dead_zone: PressureDeadZone = Field(default_factory=PressureDeadZone)
    pressure_hysteresis: PressureHysteresis = Field(default_factory=PressureHysteresis)
    pressure_crosstalk: PressureCrosstalk = Field(default_factory=PressureCrosstalk)
    actuator_gain: ActuatorGain = Field(default_factory=ActuatorGain)
    actuator_scatter: ActuatorScatter = Field(default_factory=ActuatorScatter)
    tension_gain: TensionGain = Field(default_factory=TensionGain)
    tendon_slip: TendonSlip = Field(default_factory=TendonSlip)
    tendon_slack: TendonSlack = Field(default_factory=TendonSlack)
    tendon_friction: TendonFriction = Field(default_factory=TendonFriction)
    mass_distribution: MassDistribution = Field(default_factory=MassDistribution)
    uneven_mass: UnevenMass = Field(default_factory=UnevenMass)
    payload: Payload = Field(default_factory=Payload)
    rigid_plates: RigidPlates = Field(default_factory=RigidPlates)
    soft_part: SoftPart = Field(default_factory=SoftPart)
    twisted_body: TwistedBody = Field(default_factory=TwistedBody)
    base_tilt: BaseTilt = Field(default_factory=BaseTilt)
    external_load: ExternalLoad = Field(default_factory=ExternalLoad)
    tip_wall: TipWall = Field(default_factory=TipWall)
    tethered_tip: TetheredTip = Field(default_factory=TetheredTip)
    tip_drag: TipDrag = Field(default_factory=TipDrag)
    stiffness_hardening: StiffnessHardening = Field(default_factory=StiffnessHardening)
    warm_up: WarmUp = Field(default_factory=WarmUp)
    creep: Creep = Field(default_factory=Creep)
    structural_friction: StructuralFriction = Field(default_factory=StructuralFriction)
    sensor_offset: SensorOffset = Field(default_factory=SensorOffset)
    field_distortion: FieldDistortion = Field(default_factory=FieldDistortion)
    sensor_misalignment: SensorMisalignment = Field(default_factory=SensorMisalignment)
    tracker_drift: TrackerDrift = Field(default_factory=TrackerDrift)
    base_vibration: BaseVibration = Field(default_factory=BaseVibration)
    clock_skew: ClockSkew = Field(default_factory=ClockSkew)
    sample_jitter: SampleJitter = Field(default_factory=SampleJitter)

    def only(self, kept: Callable[[Imperfection], bool]) -> Imperfections:
        """Imperfections of which only those act that `kept` is true for."""
        return self.model_copy(update={name: type(item)() for name, item in self if not kept(item)})

    def replace_kinds(self, *others: Imperfection) -> Imperfections:
        """Put each of the given imperfections in the place of the one of its kind."""
        by_kind = {type(other): other for other in others}
        return self.model_copy(update={name: by_kind.get(type(item), item) for name, item in self})

    @property
    def active(self) -> dict[str, Imperfection]:
        """Imperfections that do something, by name, in the order in which they act."""
        every: dict[str, Imperfection] = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: imperfection for name, imperfection in every.items() if imperfection.active}
