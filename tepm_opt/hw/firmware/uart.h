// The serial port, with buffers of its own: the Arduino core's cost twice the time a byte, and their size is a matter of flags.
#pragma once
#include <stdint.h>

namespace uart {

void begin();
bool take(uint8_t &byte);  // false: nothing has come
uint8_t room();            // for so many bytes
void put(const uint8_t *bytes, uint8_t count);  // only where there is room, and one at least

}  // namespace uart
