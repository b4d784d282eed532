// Written by `python -m tepm_opt.hw.board.protocol`; do not edit.
#pragma once
#include <stdint.h>

namespace protocol {

constexpr uint8_t VERSION = 2;
constexpr uint8_t CHANNELS = 6;
constexpr uint8_t POSITION_MODE = 0x80;

enum class State : uint8_t {
  IDLE = 0,
  ARMED = 1,
  HOST_TIMEOUT = 2,
  ESTOP = 3,
  FAULT = 4,
};

enum class Fault : uint8_t {
  NONE = 0,
  RESET_WHILE_ARMED = 1,
  TRAVEL = 2,
  DYNAMOMETER = 3,
  TENSION_TOO_HIGH = 4,
  MONITOR = 5,
  REGULATOR = 6,
  PRESSURE_TOO_HIGH = 7,
  BUS = 8,
  LOOP_HUNG = 9,
};

enum class Result : uint8_t {
  DONE = 0,
  WRONG_STATE = 1,
  WRONG_SESSION = 2,
  ESTOP_PRESSED = 3,
  DYNAMOMETER = 4,
  UNKNOWN_KEY = 5,
  OUT_OF_RANGE = 6,
  MONITOR = 7,
  WRONG_LIMITS = 8,
  BUS = 9,
};

enum class Key : uint8_t {
  STATUS_PERIOD_MS = 1,
  PRESSURE_SLEW = 2,
  STEP_RATE = 3,
  STEPS_PER_1000_COUNTS = 4,
};

enum class ResetCause : uint8_t {
  POWER_ON = 1,
  RESET_PIN = 2,
  BROWN_OUT = 4,
  WATCHDOG = 8,
};

struct Set {
  static constexpr uint8_t CODE = 0x01;
  uint8_t code;
  uint32_t session;
  uint32_t sequence;
  uint8_t enabled;
  uint16_t pressures[6];
  int16_t tendons[6];
} __attribute__((packed));
static_assert(sizeof(Set) == 34, "");

struct Arm {
  static constexpr uint8_t CODE = 0x02;
  uint8_t code;
  uint8_t id;
  uint32_t session;
  uint16_t limits;
} __attribute__((packed));
static_assert(sizeof(Arm) == 8, "");

struct Clear {
  static constexpr uint8_t CODE = 0x03;
  uint8_t code;
  uint8_t id;
  uint32_t session;
} __attribute__((packed));
static_assert(sizeof(Clear) == 6, "");

struct Estop {
  static constexpr uint8_t CODE = 0x04;
  uint8_t code;
  uint8_t id;
} __attribute__((packed));
static_assert(sizeof(Estop) == 2, "");

struct Config {
  static constexpr uint8_t CODE = 0x05;
  uint8_t code;
  uint8_t id;
  uint32_t session;
  uint8_t key;
  uint16_t value;
} __attribute__((packed));
static_assert(sizeof(Config) == 9, "");

struct Ask {
  static constexpr uint8_t CODE = 0x06;
  uint8_t code;
  uint8_t id;
} __attribute__((packed));
static_assert(sizeof(Ask) == 2, "");

struct Disarm {
  static constexpr uint8_t CODE = 0x07;
  uint8_t code;
  uint8_t id;
} __attribute__((packed));
static_assert(sizeof(Disarm) == 2, "");

struct Status {
  static constexpr uint8_t CODE = 0x81;
  uint8_t code;
  uint16_t sequence;
  uint8_t count;
  uint32_t session;
  uint8_t state;
  uint16_t faults;
  uint8_t fault;
  uint8_t channel;
  uint8_t enabled;
  uint16_t good;
  uint16_t bad;
  uint8_t refused;
  uint8_t stale;
  uint8_t late;
  uint32_t time_ms;
  uint16_t dynamometers[6];
  uint16_t monitors[6];
  int16_t positions[6];
} __attribute__((packed));
static_assert(sizeof(Status) == 61, "");

struct Ack {
  static constexpr uint8_t CODE = 0x82;
  uint8_t code;
  uint8_t id;
  uint8_t request;
  uint8_t result;
  uint8_t channel;
  uint8_t state;
  uint32_t session;
} __attribute__((packed));
static_assert(sizeof(Ack) == 10, "");

struct Hello {
  static constexpr uint8_t CODE = 0x83;
  uint8_t code;
  uint8_t version;
  uint8_t channels;
  uint8_t monitors;
  uint8_t reset_cause;
  uint8_t state;
  uint32_t session;
  uint32_t build;
  uint16_t limits;
  uint8_t timeout_ms;
} __attribute__((packed));
static_assert(sizeof(Hello) == 17, "");

struct Limits {
  static constexpr uint8_t CODE = 0x84;
  uint8_t code;
  int16_t code_zero;
  uint16_t codes_per_MPa;
  uint16_t pressure_max;
  uint16_t monitor_zero;
  uint16_t monitor_per_code;
  uint16_t monitor_low;
  uint16_t monitor_trip;
  uint16_t regulator_band;
  uint16_t tension_zero;
  uint16_t tension_max;
  uint16_t tension_trip;
  uint16_t dynamometer_low;
  uint16_t position_max;
  uint16_t steps_per_1000_counts;
} __attribute__((packed));
static_assert(sizeof(Limits) == 29, "");

}  // namespace protocol
