#include "fast.h"

#include "motors.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <string.h>

namespace {

struct Pass {
  uint8_t steps[TICKS];
  uint8_t directions;
};

constexpr uint8_t ALL = (1 << MOTORS) - 1;
constexpr uint32_t ACCELERATION = (uint32_t)(STEP_ACCELERATION_HZ_S / PASS_HZ / PASS_HZ * 65536);  // steps a pass a pass, 16 fractional bits
constexpr uint32_t START = (uint32_t)(STEP_START_HZ / PASS_HZ * 65536);
constexpr uint16_t BRAKE = (uint16_t)(256.0f * 65536 / 2 / ACCELERATION);  // 1 / (2 acceleration), 8 fractional bits
static_assert(START > ACCELERATION, "STEP_START_HZ is too small");
static_assert(256.0f * 65536 / 2 / ACCELERATION < 65536, "STEP_ACCELERATION_HZ_S is too small");

// When within a pass n steps happen: evenly, every second tick at the most, also across passes.
const uint8_t WHEN[STEPS_MAX + 1][STEPS_MAX] PROGMEM = {
    {},
    {10},
    {5, 15},
    {3, 10, 16},
    {2, 7, 12, 17},
    {2, 6, 10, 14, 18},
    {1, 5, 8, 11, 15, 18},
    {1, 4, 7, 10, 12, 15, 18},
    {1, 3, 6, 8, 11, 13, 16, 18},
    {1, 3, 5, 7, 10, 12, 14, 16, 18},
    {1, 3, 5, 7, 9, 11, 13, 15, 17, 19},
};
static_assert(TICKS == 20, "WHEN is written for twenty ticks");

const uint8_t BITS[] = {1, 2, 4, 8, 16, 32};  // the processor shifts by one bit at a time

Pass passes[2];
volatile uint8_t playing;  // index of the pass that the interrupt plays
volatile bool written, due, hung_;
volatile uint8_t missed_, patience;
volatile uint32_t passed;
volatile uint8_t enabled_;

int16_t position_[MOTORS];
int32_t speed[MOTORS];      // steps a pass, 16 fractional bits
uint16_t fraction[MOTORS];  // of a step that is already on its way
uint8_t directions;
uint8_t stepping[STEPS_MAX + 1];  // bits of the motors that make so many steps in the next pass

Pass &next() { return passes[playing ^ 1]; }

}  // namespace

ISR(TIMER1_COMPA_vect) {
  static uint8_t tick;
  uint8_t steps = passes[playing].steps[tick] & enabled_;  // without what is left of a pass for motors that have gone off
  if (patience && !hung_) {
    --patience;
  } else {
    hung_ = true;
    steps = 0;
    ENA_PORT |= ALL << ENA_SHIFT;
    CONTROL_PORT &= ~_BV(OUTPUTS_BIT);
  }
  STEP_PORT = (STEP_PORT & ~(ALL << STEP_SHIFT)) | steps << STEP_SHIFT;
  if (++tick < TICKS) return;
  tick = 0;
  ++passed;
  due = true;
  if (written) {
    written = false;
    playing ^= 1;
    DIR_PORT = (DIR_PORT & ~(ALL << DIR_SHIFT)) | passes[playing].directions << DIR_SHIFT;
  } else {
    memset(passes[playing].steps, 0, TICKS);
    ++missed_;
  }
}

namespace motors {

uint32_t rate_max = (uint32_t)(STEP_RATE_HZ / PASS_HZ * 65536);

void begin() {
  ENA_PORT |= ALL << ENA_SHIFT;  // off, before the pins are outputs
  ENA_DDR |= ALL << ENA_SHIFT;
  STEP_DDR |= ALL << STEP_SHIFT;
  DIR_DDR |= ALL << DIR_SHIFT;
  patience = PATIENCE;
  TCCR1A = 0;
  TCCR1B = _BV(WGM12) | _BV(CS10);
  OCR1A = F_CPU / PASS_HZ / TICKS - 1;
  TIMSK1 = _BV(OCIE1A);
}

bool pass_due() {
  if (!due || written) return false;
  due = false;
  return true;
}

uint32_t time() {
  const uint8_t status = SREG;
  cli();
  const uint32_t value = passed;
  SREG = status;
  return value;
}

uint8_t missed() { return missed_; }

void enable(uint8_t bits) {
  if (hung_) bits = 0;
  const uint8_t rising = bits & ~enabled_;
  for (uint8_t motor = 0; motor < MOTORS; ++motor) {
    if (rising & 1 << motor) position_[motor] = 0;
    if (!(bits & 1 << motor)) speed[motor] = fraction[motor] = 0;
  }
  enabled_ = bits & ALL;
  const uint8_t status = SREG;
  cli();
  ENA_PORT = (ENA_PORT & ~(ALL << ENA_SHIFT)) | (~enabled_ & ALL) << ENA_SHIFT;
  __asm__ volatile("" ::: "memory");
  SREG = status;
}

void alive() { patience = PATIENCE; }

bool hung() { return hung_; }

void forgive() { hung_ = false; }

uint8_t enabled() { return enabled_; }

int16_t position(uint8_t motor) { return position_[motor]; }

void plan() { memset(stepping, 0, sizeof stepping); }

void to(uint8_t motor, int32_t distance, bool gently) {
  const uint8_t bit = BITS[motor];
  if (!(enabled_ & bit)) return;
  const bool ahead = distance > 0, forwards = speed[motor] > 0;
  const uint32_t way = ahead ? distance : -distance;
  uint32_t size = forwards ? speed[motor] : -speed[motor];
  const uint16_t coarse = size >> 8;
  const uint32_t brake = ((uint32_t)(uint16_t)((uint32_t)coarse * coarse >> 8) * BRAKE >> 8) + coarse;  // if it begins a pass later
  const uint32_t most = gently ? way << 5 : way << 8;  // an eighth of the way in a pass, or all of it
  bool up = ahead;
  if (size > START && (ahead != forwards || brake >= way)) {
    up = forwards;
    size = size > START + ACCELERATION ? size - ACCELERATION : START;
    if (up == ahead && size == START && size > most) size = most;
  } else {
    size = size >= START && ahead == forwards ? size + ACCELERATION : START;
    if (size > rate_max) size = rate_max;
    if (size > most) size = most;
  }
  speed[motor] = up ? size : -size;
  const uint32_t sum = fraction[motor] + size;
  fraction[motor] = sum;
  uint8_t count = sum >> 16;
  if (count == 0) return;
  if (count > STEPS_MAX) count = STEPS_MAX;
  if (up != !!(directions & bit)) {
    directions ^= bit;
    count = 1;  // in the middle of the pass: time for the driver to see the new direction
  }
  position_[motor] += up ? count : -count;
  stepping[count] |= bit;
}

// Motors that make as many steps make them together: six at full rate cost no more than one.
void commit() {
  uint8_t *steps = next().steps;
  memset(steps, 0, TICKS);
  for (uint8_t count = 1; count <= STEPS_MAX; ++count) {
    const uint8_t bits = stepping[count], *when = WHEN[count];
    if (bits == 0) continue;
    for (uint8_t left = count; left; --left) steps[pgm_read_byte(when++)] |= bits;
  }
  next().directions = directions;
  __asm__ volatile("" ::: "memory");  // the pass before the flag
  written = true;
}

}  // namespace motors
