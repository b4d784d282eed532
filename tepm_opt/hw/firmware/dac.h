// Pressure set points to the regulators.
#pragma once
#include <stdint.h>

namespace dac {

bool begin();                                // all channels at 0; whether all took that
void write(uint8_t channel, uint16_t code);  // 0 ... 4095
void turn(uint32_t now);                     // every pass; now: the clock in ms
bool hung();                                 // what was written does not arrive, for BUS_MS by now

}  // namespace dac
