#include "board.h"

#include <avr/io.h>

#include "adc.h"
#include "config.h"
#include "dac.h"
#include "motors.h"

#ifndef BUILD
#define BUILD 0
#endif

using namespace protocol;

namespace {

static_assert(MOTORS <= CHANNELS && DACS <= CHANNELS, "the messages have no room for so many");

constexpr uint16_t TIMEOUT_PASSES = (uint32_t)TIMEOUT_MS * PASS_HZ / 1000;
constexpr uint16_t REGULATOR_PASSES = (uint32_t)REGULATOR_TIME_MS * PASS_HZ / 1000;
constexpr float CODES_PER_MPA = 4096 / PRESSURE_FULL_SCALE_MPA;
constexpr uint16_t SLEW = (uint16_t)(PRESSURE_SLEW_MPA_S * CODES_PER_MPA / PASS_HZ * 256);  // DAC codes a pass, 8 fractional bits
constexpr uint16_t RAMP = (uint16_t)(PRESSURE_RAMP_MPA_S * CODES_PER_MPA / PASS_HZ * 256);
constexpr uint16_t STEPS_PER_COUNT = (uint16_t)(STEPS_PER_N / TENSION_COUNTS_PER_N * 65536);  // 16 fractional bits
constexpr uint16_t MONITOR_COUNTS = (uint16_t)(MONITOR_COUNTS_PER_DAC_CODE * 256 + 0.5f);  // for a DAC code, 8 fractional bits
constexpr uint8_t STATUS_MS = BAUD >= 250000L ? 5 : 10;  // the line has no room for more
constexpr uint8_t TRIPS = 2;         // samples one after the other above TENSION_TRIP
constexpr uint8_t DEAD_SAMPLES = 5;  // outside of the dynamometer's range

// What survives a reset of the processor, but not of the power: that the robot was armed, and the number of the session.
struct Memory {
  uint16_t mark;
  uint8_t session, not_session, armed;
} memory __attribute__((section(".noinit")));
constexpr uint16_t MARK = 0x7E9A;

State state_;
Fault fault_;
uint8_t channel_, reset_cause_;
uint8_t sequence_, refused_;
uint16_t silence;  // passes since the last set point
uint8_t turn;      // the regulator whose pass it is

uint8_t wanted_enabled;
bool position_mode;
uint16_t wanted_pressure[CHANNELS];
int16_t wanted_tendon[CHANNELS];

uint32_t applied[DACS];  // DAC codes, 8 fractional bits
uint16_t code_[DACS];
uint16_t smooth[MOTORS], before[MOTORS];  // dynamometers: the mean of the last two samples, and the last one
int32_t aim[MOTORS];                       // 1/256 steps, where samples are rare
uint8_t trips[MOTORS], dead[MOTORS];
uint16_t stuck[DACS];

uint16_t slew = SLEW, steps_per_count = STEPS_PER_COUNT;
uint8_t status_passes_;

bool estop_pressed() { return ESTOP_PIN & _BV(ESTOP_BIT); }

// Out of ARMED, or from one fault to another: motors off now, pressure on its way to zero. Where that cannot be trusted, as with a regulator
// that does not follow, the outputs go off, which vents everything, and the DACs to zero, so that nothing is there again after CLEAR.
void leave(State to, Fault fault = Fault::NONE, uint8_t channel = 0) {
  motors::enable(0);
  if (state_ == State::ARMED) memory.not_session = ~++memory.session;
  memory.armed = 0;
  state_ = to;
  fault_ = fault;
  channel_ = channel;
  wanted_enabled = 0;
  for (uint8_t k = 0; k < CHANNELS; ++k) wanted_pressure[k] = 0;
  if (to == State::ESTOP || fault == Fault::LOOP_HUNG || fault == Fault::REGULATOR) {
    CONTROL_PORT &= ~_BV(OUTPUTS_BIT);
    for (uint8_t k = 0; k < DACS; ++k) dac::write(k, applied[k] = code_[k] = 0);
  }
}

void fail(Fault fault, uint8_t channel = 0) {
  if (state_ != State::FAULT && state_ != State::ESTOP) leave(State::FAULT, fault, channel);
}

bool dynamometer_dead(uint8_t motor) {
  const uint16_t value = adc::dynamometer(motor);
  return value < DYNAMOMETER_LOW || value > DYNAMOMETER_HIGH;
}

void watch_tendons() {
  for (uint8_t k = 0; k < MOTORS; ++k) {
    const uint16_t value = adc::dynamometer(k);
    smooth[k] = (value + before[k]) / 2;
    before[k] = value;
    if (value <= TENSION_TRIP) {
      trips[k] = 0;
    } else if (value <= DYNAMOMETER_HIGH) {
      ++trips[k];
    }
    dead[k] = dynamometer_dead(k) ? dead[k] + 1 : 0;
    if (state_ != State::ARMED) {
      trips[k] = dead[k] = 0;
    } else if (trips[k] >= TRIPS) {
      fail(Fault::TENSION_TOO_HIGH, k);
    } else if (dead[k] >= DEAD_SAMPLES) {
      fail(Fault::DYNAMOMETER, k);
    } else if (motors::position(k) > TRAVEL_MAX || motors::position(k) < -TRAVEL_MAX) {
      fail(Fault::TRAVEL, k);
    }
  }
}

// One regulator a pass. Its monitor follows within a second or so; one that does not is stuck, whatever it was told.
void watch_regulator(uint8_t k) {
  if (MONITORS == 0) return;
  const int16_t expected = MONITOR_ZERO + ((uint32_t)code_[k] * MONITOR_COUNTS >> 8);
  const int16_t off = (int16_t)adc::monitor(k) - expected;
  stuck[k] = off > (int16_t)REGULATOR_BAND || off < -(int16_t)REGULATOR_BAND ? stuck[k] + DACS : 0;
  if (stuck[k] >= REGULATOR_PASSES) {
    stuck[k] = 0;
    fail(Fault::REGULATOR, k);
  }
}

// One regulator a pass.
void drive_regulator(uint8_t k) {
  const uint32_t goal = (uint32_t)wanted_pressure[k] << 8;
  const uint32_t most = (uint32_t)DACS * (state_ == State::ARMED ? slew : RAMP);
  uint32_t &now = applied[k];
  if (now < goal) {
    now = goal - now > most ? now + most : goal;
  } else {
    now = now - goal > most ? now - most : goal;
  }
  code_[k] = now >> 8;
  if (code_[k] > PRESSURE_MAX) code_[k] = PRESSURE_MAX;
  dac::write(k, code_[k]);
}

void drive_motors() {
  const uint8_t fresh = adc::fresh();
  motors::plan();
  if (state_ == State::ARMED) {
    for (uint8_t k = 0; k < MOTORS; ++k) {
      int32_t way;
      if (position_mode) {
        way = ((int32_t)wanted_tendon[k] - motors::position(k)) * 256;
      } else {
        const int16_t missing = wanted_tendon[k] - (int16_t)smooth[k];
        const bool close = missing <= TENSION_DEAD_BAND && missing >= -(int16_t)TENSION_DEAD_BAND;
        way = close ? 0 : (int32_t)missing * steps_per_count >> 8;
        if (ADC_TENSION == ADC_INTERNAL) {  // samples come every 5 to 20 ms: half the way on each, and not again before the next
          if (fresh & 1 << k) aim[k] = motors::position(k) * 256L + way / 2;
          way = aim[k] - motors::position(k) * 256L;
        }
      }
      motors::to(k, way, !position_mode);
      motors::alive();
    }
  }
  motors::commit();
}

}  // namespace

namespace board {

void begin(uint8_t reset_cause) {
  reset_cause_ = reset_cause;
  status_passes_ = STATUS_MS * (PASS_HZ / 1000);
  const bool known = memory.mark == MARK && memory.not_session == (uint8_t)~memory.session;
  const bool was_armed = known && memory.armed == 1;
  if (!known) memory.session = 0;
  memory = {MARK, (uint8_t)(memory.session + 1), (uint8_t) ~(memory.session + 1), 0};
  state_ = was_armed ? State::FAULT : State::IDLE;
  fault_ = was_armed ? Fault::RESET_WHILE_ARMED : Fault::NONE;

  CONTROL_PORT &= ~_BV(OUTPUTS_BIT);
  CONTROL_DDR |= _BV(OUTPUTS_BIT);
  ESTOP_PORT |= _BV(ESTOP_BIT);  // pull-up
  dac::begin();
  adc::begin();
  motors::begin();
  CONTROL_PORT |= _BV(OUTPUTS_BIT);
}

void pass() {
  adc::convert();
  turn = turn + 1 < DACS ? turn + 1 : 0;
  if (estop_pressed() && state_ != State::ESTOP) leave(State::ESTOP);
  if (motors::hung()) fail(Fault::LOOP_HUNG);
  if (state_ == State::ARMED && ++silence > TIMEOUT_PASSES) leave(State::HOST_TIMEOUT);
  watch_regulator(turn);
  drive_regulator(turn);
  motors::alive();
  adc::read();
  motors::alive();
  watch_tendons();
  drive_motors();
}

void set(const Set &message) {
  if ((int8_t)(message.sequence - sequence_) <= 0) return;  // old: neither done nor a sign of life
  bool allowed = !(message.enabled & ~(POSITION_MODE | ((1 << MOTORS) - 1)));
  const bool steps = message.enabled & POSITION_MODE;
  for (uint8_t k = 0; k < CHANNELS; ++k) {
    const int16_t most = k >= MOTORS ? 0 : steps ? POSITION_MAX : (int16_t)TENSION_MAX;
    allowed &= message.pressures[k] <= (k < DACS ? PRESSURE_MAX : 0) && message.tendons[k] >= 0 && message.tendons[k] <= most;
  }
  if (!allowed) {
    ++refused_;
    return;
  }
  sequence_ = message.sequence;
  if (state_ != State::ARMED) return;
  silence = 0;
  position_mode = steps;
  for (uint8_t k = 0; k < CHANNELS; ++k) {
    wanted_pressure[k] = message.pressures[k];
    wanted_tendon[k] = message.tendons[k];
  }
  if (message.enabled != wanted_enabled) {
    wanted_enabled = message.enabled;
    motors::enable(message.enabled);
    for (uint8_t k = 0; k < MOTORS; ++k) aim[k] = motors::position(k) * 256L;
  }
}

Result arm(const Arm &message) {
  if (message.session != memory.session) return Result::WRONG_SESSION;
  if (estop_pressed()) return Result::ESTOP_PRESSED;
  if (state_ != State::IDLE) return Result::WRONG_STATE;
  for (uint8_t k = 0; k < MOTORS; ++k) {
    if (dynamometer_dead(k)) {
      channel_ = k;
      return Result::DYNAMOMETER;
    }
  }
  sequence_ = message.sequence;
  silence = 0;
  memory.armed = 1;
  state_ = State::ARMED;
  return Result::DONE;
}

Result clear(uint8_t session) {
  if (session != memory.session) return Result::WRONG_SESSION;
  if (state_ == State::ARMED) return Result::WRONG_STATE;
  if (estop_pressed()) return Result::ESTOP_PRESSED;
  motors::forgive();
  leave(State::IDLE);
  memory.not_session = ~++memory.session;
  CONTROL_PORT |= _BV(OUTPUTS_BIT);
  return Result::DONE;
}

Result estop() {
  leave(State::ESTOP);
  return Result::DONE;
}

Result disarm() {
  if (state_ == State::ARMED) leave(State::IDLE);
  return Result::DONE;
}

Result config(uint8_t key, uint16_t value) {
  switch ((Key)key) {
    case Key::STATUS_PERIOD_MS:
      if (value < STATUS_MS || value > 100) return Result::OUT_OF_RANGE;
      status_passes_ = value * (PASS_HZ / 1000);
      return Result::DONE;
    case Key::PRESSURE_SLEW:
      if (value < 1 || value > SLEW) return Result::OUT_OF_RANGE;
      slew = value;
      return Result::DONE;
    case Key::STEP_RATE: {
      const uint32_t rate = (uint32_t)value * 65536UL / PASS_HZ;
      if (value < 1 || value > (uint16_t)STEP_RATE_HZ) return Result::OUT_OF_RANGE;
      motors::rate_max = rate;
      return Result::DONE;
    }
    case Key::STEPS_PER_1000_COUNTS:
      if (value < 1 || value > 900) return Result::OUT_OF_RANGE;
      steps_per_count = (uint32_t)value * 65536UL / 1000;
      return Result::DONE;
  }
  return Result::UNKNOWN_KEY;
}

State state() { return state_; }

uint8_t session() { return memory.session; }

uint8_t status_passes() { return status_passes_; }

void report(Status &message) {
  message.sequence = sequence_;
  message.session = memory.session;
  message.state = (uint8_t)state_;
  message.fault = (uint8_t)fault_;
  message.channel = channel_;
  message.enabled = motors::enabled() | (position_mode ? POSITION_MODE : 0);
  message.refused = refused_;
  message.late = motors::missed();
  message.time_us = motors::time() * (1000000UL / PASS_HZ);
  for (uint8_t k = 0; k < CHANNELS; ++k) {
    message.dynamometers[k] = k < MOTORS ? adc::dynamometer(k) : 0;
    message.monitors[k] = adc::monitor(k);
    message.positions[k] = k < MOTORS ? motors::position(k) : 0;
  }
}

void report(Hello &message) {
  message.version = VERSION;
  message.channels = MOTORS;
  message.reset_cause = reset_cause_;
  message.state = (uint8_t)state_;
  message.session = memory.session;
  message.build = BUILD;
  message.pressure_max = PRESSURE_MAX;
  message.tension_max = TENSION_MAX;
  message.timeout_ms = TIMEOUT_MS;
}

}  // namespace board
