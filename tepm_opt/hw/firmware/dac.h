// Pressure set points to the regulators.
#pragma once
#include <stdint.h>

namespace dac {

void begin();                                // all channels at 0
void write(uint8_t channel, uint16_t code);  // 0 ... 4095

}  // namespace dac
