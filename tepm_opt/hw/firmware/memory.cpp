#include "fast.h"

#include "memory.h"

#include <avr/eeprom.h>
#include <avr/io.h>

#include "frames.h"

// The upper half of a session's number counts the starts of the board in its EEPROM, the lower half goes on from noise: what the memory
// (RAM) held at power-on. So no session comes twice until the EEPROM has been erased or worn out, and then once in 65,536 times.
namespace {

struct Start {
  uint16_t number, inverse;
};
constexpr uint8_t PLACES = 16;  // used in turn: 100,000 writes each
Start starts[PLACES] EEMEM;

// Not set to zero by a reset.
uint16_t armed_ __attribute__((section(".noinit")));
constexpr uint16_t ARMED = 0x7E9A;

uint32_t session_;

extern "C" uint8_t __heap_start;

uint16_t noise() {
  uint16_t sum = 0xFFFF;
  for (const uint8_t *byte = &__heap_start; byte < (const uint8_t *)SP; ++byte) sum = crc16(sum, *byte);
  return sum;
}

// A write that a power cut tears leaves a place whose inverse is wrong: it does not count.
uint16_t count_start(uint16_t otherwise) {
  uint8_t at = PLACES - 1;
  bool found = false;
  Start last = {otherwise, 0};
  for (uint8_t k = 0; k < PLACES; ++k) {
    Start start;
    eeprom_read_block(&start, &starts[k], sizeof start);
    if ((start.number ^ start.inverse) != 0xFFFF || (found && (int16_t)(start.number - last.number) < 0)) continue;
    found = true;
    last = start;
    at = k;
  }
  const uint16_t number = last.number + 1;
  last = {number, (uint16_t)~number};
  eeprom_write_block(&last, &starts[at + 1 < PLACES ? at + 1 : 0], sizeof last);
  return number;
}

}  // namespace

namespace memory {

bool begin() {
  const uint16_t lower = noise();
  session_ = (uint32_t)count_start(lower) << 16 | lower;
  const bool was_armed = armed_ == ARMED;
  armed_ = 0;
  return was_armed;
}

void armed(bool on) { armed_ = on ? ARMED : 0; }

uint32_t session() { return session_; }

void next_session() { session_ = (session_ & 0xFFFF0000) | (uint16_t)(session_ + 1); }

}  // namespace memory
