#include "fast.h"

#include "board.h"

#include <avr/io.h>

#include "adc.h"
#include "config.h"
#include "dac.h"
#include "frames.h"
#include "memory.h"
#include "motors.h"

#ifndef BUILD
#define BUILD 0
#endif

using namespace protocol;

namespace {

static_assert(MOTORS <= CHANNELS && DACS <= CHANNELS, "the messages have no room for so many");

constexpr uint16_t SLEW = (uint16_t)(PRESSURE_SLEW_MPA_S * LIMITS.codes_per_MPa / 1000 * 256);  // DAC codes a ms, 8 fractional bits
constexpr uint16_t RAMP = (uint16_t)(PRESSURE_RAMP_MPA_S * LIMITS.codes_per_MPa / 1000 * 256);
constexpr uint16_t STEPS_PER_COUNT = LIMITS.steps_per_1000_counts * 65536UL / 1000;  // 16 fractional bits
constexpr uint8_t STATUS_MS = BAUD >= 250000L ? 5 : 10;  // the line has no room for more

// What is wrong now and then is found as well as what is wrong all the time: counters rise while it is, and fall slowly while it is not.
struct Level {
  uint16_t value;
  bool reaches(uint16_t most, bool wrong, uint16_t rise, uint16_t fall) {
    if (wrong) {
      value += rise;
      if (value < most) return false;
      value = most;
      return true;
    }
    value = value > fall ? value - fall : 0;
    return false;
  }
};
#if ADC_TENSION == ADC_AD7606  // a sample a ms: 2 ms, 5 ms; or a contact that is lost more than a third of the time
constexpr uint8_t TRIP_SAMPLES = 2, DEAD_SAMPLES = 10, LOST = 2, JUMPED = 2;
#else  // a sample is worth 20
constexpr uint8_t TRIP_SAMPLES = 1, DEAD_SAMPLES = 2, LOST = 2, JUMPED = 1;
#endif
constexpr uint16_t JUMP = (LIMITS.tension_max - LIMITS.tension_zero) / 4;  // counts from a sample to the next: no arm moves so fast

State state_;
uint16_t faults_;
Fault fault_;  // the gravest
uint8_t channel_, reset_cause_;
uint32_t sequence_;
uint8_t refused_, stale_;
uint32_t now, heard;  // the clock in ms: at this pass, at the last set point
uint16_t limits_check;
uint8_t turn;         // the regulator whose pass it is

uint8_t wanted_enabled;
bool position_mode;
uint16_t wanted_pressure[CHANNELS];
int16_t wanted_tendon[CHANNELS];

uint32_t applied[DACS];  // DAC codes, 8 fractional bits
uint16_t code_[DACS];
uint32_t driven[DACS];                     // the clock when it was written last
uint16_t smooth[MOTORS], before[MOTORS];   // dynamometers: the mean of the last two good samples; the last within its range
uint16_t good[MOTORS];                     // the last one in which nothing was wrong
bool lost[MOTORS];                         // something was wrong with the last sample
int32_t aim[MOTORS];                       // 1/256 steps, where samples are rare
uint8_t trips[MOTORS], dead[MOTORS];
Level over[DACS], broken[DACS], stuck[DACS];

uint16_t slew = SLEW, steps_per_count = STEPS_PER_COUNT;
uint8_t status_passes_;

// The number of set points begins anew with the session.
void new_session() {
  memory::next_session();
  sequence_ = 0;
}

bool estop_pressed() { return ESTOP_PIN & _BV(ESTOP_BIT); }

// Vents everything, and sets the DACs to zero, so that nothing is there again after CLEAR.
void outputs_off() {
  CONTROL_PORT &= ~_BV(OUTPUTS_BIT);
  for (uint8_t k = 0; k < DACS; ++k) dac::write(k, applied[k] = code_[k] = 0);
}

// Out of ARMED, or from one stop to another: motors off now, pressure on its way to zero.
void leave(State to) {
  motors::enable(0);
  if (state_ == State::ARMED) new_session();
  memory::armed(false);
  state_ = to;
  wanted_enabled = 0;
  for (uint8_t k = 0; k < CHANNELS; ++k) wanted_pressure[k] = 0;
}

void stop() {
  leave(State::ESTOP);
  outputs_off();
}

// Every fault is kept, and acts, whatever came before it. From MONITOR on pressure cannot be trusted to follow.
void fail(Fault fault, uint8_t channel = 0) {
  const uint16_t bit = 1 << (uint8_t)fault >> 1;
  if (faults_ & bit) return;
  faults_ |= bit;
  if (fault > fault_) {
    fault_ = fault;
    channel_ = channel;
  }
  if (state_ != State::ESTOP) leave(State::FAULT);
  if (fault >= Fault::MONITOR) outputs_off();
}

bool dynamometer_dead(uint8_t motor) {
  const uint16_t value = adc::dynamometer(motor);
  return value < LIMITS.dynamometer_low || value > DYNAMOMETER_HIGH;
}

// The loop and the trip look at the same: samples in which nothing is wrong. A contact that is lost now and then neither winds the tendon
// nor hides what it pulls.
void watch_tendon(uint8_t k) {
  const uint16_t value = adc::dynamometer(k), change = value > before[k] ? value - before[k] : before[k] - value;
  const bool out = dynamometer_dead(k);
  if (!out) before[k] = value;
  lost[k] = out || change > JUMP;
  if (!lost[k]) {
    smooth[k] = (value + good[k]) / 2;
    good[k] = value;
  }
  if (state_ != State::ARMED) return;
  if (smooth[k] > LIMITS.tension_trip) {
    if (++trips[k] >= TRIP_SAMPLES) fail(Fault::TENSION_TOO_HIGH, k);
  } else if (trips[k]) {
    --trips[k];
  }
  if (lost[k]) {
    dead[k] += out ? LOST : JUMPED;
    if (dead[k] >= DEAD_SAMPLES) fail(Fault::DYNAMOMETER, k);
  } else if (dead[k]) {
    --dead[k];
  }
}

void watch_tendons(uint8_t fresh) {
  for (uint8_t k = 0; k < MOTORS; ++k) {
    if (fresh & 1 << k) watch_tendon(k);
    if (state_ == State::ARMED && (motors::position(k) > TRAVEL_MAX || motors::position(k) < -TRAVEL_MAX)) fail(Fault::TRAVEL, k);
  }
}

int16_t off_set_point(uint8_t k) {
  const int16_t code = (int16_t)code_[k] - LIMITS.code_zero;
  const uint16_t counts = code > 0 ? (uint32_t)code * LIMITS.monitor_per_code >> 8 : 0;
  return (int16_t)(adc::monitor(k) - LIMITS.monitor_zero - counts);
}

bool disagrees(uint8_t k) {
  const int16_t off = off_set_point(k);
  return off > (int16_t)LIMITS.regulator_band || off < -(int16_t)LIMITS.regulator_band;
}

// One regulator a pass, in every state. Its monitor follows within a second or so; one that does not is stuck, whatever it was told.
void watch_regulator(uint8_t k, uint8_t ms) {
  if (MONITORS == 0) return;
  const uint16_t value = adc::monitor(k);
  if (over[k].reaches(4 * MONITOR_MS, value > LIMITS.monitor_trip, 4 * ms, ms)) fail(Fault::PRESSURE_TOO_HIGH, k);
  if (broken[k].reaches(4 * MONITOR_MS, value < LIMITS.monitor_low, 4 * ms, ms)) fail(Fault::MONITOR, k);
  if (stuck[k].reaches(REGULATOR_MS, disagrees(k), ms, ms)) fail(Fault::REGULATOR, k);
}

// The regulator whose monitor shows what no regulator in order shows by now; DACS where there is none.
uint8_t regulator_in_disorder() {
  uint8_t k = MONITORS ? 0 : DACS;
  while (k < DACS && !disagrees(k) && adc::monitor(k) >= LIMITS.monitor_low && adc::monitor(k) <= LIMITS.monitor_trip) ++k;
  return k;
}

// One regulator a pass.
void drive_regulator(uint8_t k, uint8_t ms) {
  const uint32_t goal = (uint32_t)wanted_pressure[k] << 8;
  const uint32_t most = (uint32_t)ms * (state_ == State::ARMED ? slew : RAMP);
  uint32_t &now = applied[k];
  if (now < goal) {
    now = goal - now > most ? now + most : goal;
  } else {
    now = now - goal > most ? now - most : goal;
  }
  code_[k] = now >> 8;
  if (code_[k] > LIMITS.pressure_max) code_[k] = LIMITS.pressure_max;
  dac::write(k, code_[k]);
}

void drive_motors(uint8_t fresh) {
  motors::plan();
  if (state_ == State::ARMED) {
    for (uint8_t k = 0; k < MOTORS; ++k) {
      int32_t way;
      if (position_mode) {
        way = ((int32_t)wanted_tendon[k] - motors::position(k)) * 256;
      } else {
        const int16_t missing = wanted_tendon[k] - (int16_t)smooth[k];
        const bool close = missing <= TENSION_DEAD_BAND && missing >= -(int16_t)TENSION_DEAD_BAND;
        way = close || lost[k] ? 0 : (int32_t)missing * steps_per_count >> 8;
        if (ADC_TENSION == ADC_INTERNAL) {  // samples come every 5 to 20 ms: half the way on each, and not again before the next
          if (fresh & 1 << k && !lost[k]) aim[k] = motors::position(k) * 256L + way / 2;
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
  limits_check = 0xFFFF;
  for (uint8_t k = 0; k < sizeof LIMITS; ++k) limits_check = crc16(limits_check, ((const uint8_t *)&LIMITS)[k]);
  limits_check = ~limits_check;

  CONTROL_PORT &= ~_BV(OUTPUTS_BIT);
  CONTROL_DDR |= _BV(OUTPUTS_BIT);
  ESTOP_PORT |= _BV(ESTOP_BIT);  // pull-up
  state_ = State::IDLE;
  const bool dacs = dac::begin(), was_armed = memory::begin();
  adc::begin();
  motors::begin();
  if (was_armed) fail(Fault::RESET_WHILE_ARMED);
  if (dacs) CONTROL_PORT |= _BV(OUTPUTS_BIT);
  else fail(Fault::BUS);
}

void pass() {
  adc::convert();
  now = motors::time();
  turn = turn + 1 < DACS ? turn + 1 : 0;
  const uint32_t since = now - driven[turn];
  const uint8_t ms = since < 255 ? since : 255;
  driven[turn] = now;
  if (estop_pressed() && state_ != State::ESTOP) stop();
  if (motors::hung()) fail(Fault::LOOP_HUNG);
  dac::turn(now);
  if (dac::hung()) fail(Fault::BUS);
  if (state_ == State::ARMED && now - heard > TIMEOUT_MS) leave(State::HOST_TIMEOUT);
  motors::alive();
  watch_regulator(turn, ms);
  drive_regulator(turn, ms);
  motors::alive();
  adc::read();
  motors::alive();
  const uint8_t fresh = adc::fresh();
  watch_tendons(fresh);
  motors::alive();
  drive_motors(fresh);
}

void set(const Set &message) {
  // From before the robot was armed, from another arming, or old: neither done nor a sign of life.
  if (state_ != State::ARMED || message.session != memory::session() || message.sequence <= sequence_) {
    ++stale_;
    return;
  }
  bool allowed = !(message.enabled & ~(POSITION_MODE | ((1 << MOTORS) - 1)));
  const bool steps = message.enabled & POSITION_MODE;
  for (uint8_t k = 0; k < CHANNELS; ++k) {
    const int16_t most = k >= MOTORS ? 0 : steps ? LIMITS.position_max : LIMITS.tension_max;
    allowed &= message.pressures[k] <= (k < DACS ? LIMITS.pressure_max : 0) && message.tendons[k] >= 0 && message.tendons[k] <= most;
  }
  if (!allowed) {
    ++refused_;
    return;
  }
  sequence_ = message.sequence;
  heard = now;
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

// `channel` becomes the actuator that an answer is about.
Result arm(const Arm &message, uint8_t &channel) {
  if (message.session != memory::session()) return Result::WRONG_SESSION;
  if (message.limits != limits_check) return Result::WRONG_LIMITS;
  if (estop_pressed()) return Result::ESTOP_PRESSED;
  if (state_ != State::IDLE) return Result::WRONG_STATE;
  if (dac::hung()) return Result::BUS;
  for (channel = 0; channel < MOTORS; ++channel) {
    if (dynamometer_dead(channel)) return Result::DYNAMOMETER;
  }
  channel = regulator_in_disorder();
  if (channel < DACS) return Result::MONITOR;
  for (uint8_t k = 0; k < MOTORS; ++k) trips[k] = dead[k] = 0;
  new_session();
  heard = now;
  memory::armed(true);
  state_ = State::ARMED;
  channel = 0;
  return Result::DONE;
}

Result clear(uint32_t session, uint8_t &channel) {
  if (session != memory::session()) return Result::WRONG_SESSION;
  if (state_ == State::ARMED) return Result::WRONG_STATE;
  if (estop_pressed()) return Result::ESTOP_PRESSED;
  if (dac::hung()) return Result::BUS;
  channel = regulator_in_disorder();
  if (channel < DACS) return Result::MONITOR;
  motors::forgive();
  leave(State::IDLE);
  new_session();
  faults_ = 0;
  fault_ = Fault::NONE;
  channel = channel_ = 0;
  for (uint8_t k = 0; k < DACS; ++k) over[k].value = broken[k].value = stuck[k].value = 0;
  CONTROL_PORT |= _BV(OUTPUTS_BIT);
  return Result::DONE;
}

Result estop() {
  stop();
  return Result::DONE;
}

Result disarm() {
  if (state_ == State::ARMED) leave(State::IDLE);
  return Result::DONE;
}

Result config(uint32_t session, uint8_t key, uint16_t value) {
  if (session != memory::session()) return Result::WRONG_SESSION;
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

uint8_t status_passes() { return status_passes_; }

void report(Status &message) {
  message.sequence = sequence_;
  message.session = memory::session();
  message.state = (uint8_t)state_;
  message.faults = faults_;
  message.fault = (uint8_t)fault_;
  message.channel = channel_;
  message.enabled = motors::enabled() | (position_mode ? POSITION_MODE : 0);
  message.refused = refused_;
  message.stale = stale_;
  message.late = motors::missed();
  message.time_ms = motors::time() * (1000 / PASS_HZ);
  for (uint8_t k = 0; k < CHANNELS; ++k) {
    message.dynamometers[k] = k < MOTORS ? adc::dynamometer(k) : 0;
    message.monitors[k] = adc::monitor(k);
    message.positions[k] = k < MOTORS ? motors::position(k) : 0;
  }
}

void report(Hello &message) {
  message.version = VERSION;
  message.channels = MOTORS;
  message.monitors = MONITORS;
  message.reset_cause = reset_cause_;
  message.state = (uint8_t)state_;
  message.session = memory::session();
  message.build = BUILD;
  message.limits = limits_check;
  message.timeout_ms = TIMEOUT_MS;
}

}  // namespace board
