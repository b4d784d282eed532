// What outlives a reset or a power cut: that the robot was armed, and numbers of sessions, none of which comes twice.
#pragma once
#include <stdint.h>

namespace memory {

bool begin();         // whether the robot was armed when the processor was reset; there is a new session then
void armed(bool on);  // until a reset without loss of power
uint32_t session();
void next_session();

}  // namespace memory
