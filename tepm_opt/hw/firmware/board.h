// What the board does with set points: states, limits, faults. It decides about safety by itself; the host can only ask.
#pragma once
#include <stdint.h>

#include "protocol.h"

namespace board {

void begin(uint8_t reset_cause);
void pass();  // every millisecond

void set(const protocol::Set &message);
protocol::Result arm(const protocol::Arm &message, uint8_t &channel);  // `channel`: the actuator that the answer is about
protocol::Result clear(uint32_t session, uint8_t &channel);
protocol::Result estop();
protocol::Result disarm();
protocol::Result config(uint32_t session, uint8_t key, uint16_t value);

protocol::State state();
uint8_t status_passes();                 // between two STATUS
void report(protocol::Status &message);  // all but the counters of frames
void report(protocol::Hello &message);

}  // namespace board
