// Limits and calibration of robot kang2017, which host and board compare. Written by `tepm hw limits`; do not edit.
#pragma once
#include "protocol.h"

constexpr protocol::Limits LIMITS = {
    protocol::Limits::CODE,
    0,  // code_zero: DAC code at no pressure
    4551,  // codes_per_MPa: DAC codes a MPa
    2275,  // pressure_max: DAC code of the largest pressure
    6554,  // monitor_zero: counts of a monitor at no pressure
    1638,  // monitor_per_code: 1/256 counts of a monitor a DAC code
    3276,  // monitor_low: counts of a monitor below which it is broken; 0 where it has no live zero
    22573,  // monitor_trip: counts of a monitor that no pressure may exceed
    2900,  // regulator_band: counts by which a monitor may be off its set point
    3277,  // tension_zero: counts of a dynamometer without tension
    26215,  // tension_max: counts of a dynamometer at the largest tension
    27361,  // tension_trip: counts of a dynamometer that no tension may exceed
    1638,  // dynamometer_low: counts of a dynamometer below which it is broken
    6667,  // position_max: steps of a motor at the largest tension, in position mode
    291,  // steps_per_1000_counts: of a motor for 1000 counts of its dynamometer: the gain of the tension loop
};
