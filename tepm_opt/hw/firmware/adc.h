// Dynamometers and pressure monitors, in counts of 15 bits over 5 V.
#pragma once
#include <stdint.h>

namespace adc {

void begin();
void convert();  // at the start of a pass
void read();     // at least 5 us later
uint8_t fresh(); // bits of the dynamometers that were measured anew since the last call
uint16_t dynamometer(uint8_t channel);
uint16_t monitor(uint8_t channel);

}  // namespace adc
