// Frames to and from the host.
#pragma once

namespace link {

void begin();
void receive();  // what came since the last pass, at most so much that the pass is not late
void send();     // STATUS when it is due, bit by bit

}  // namespace link
