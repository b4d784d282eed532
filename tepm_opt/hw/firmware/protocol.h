// Written by `python -m tepm_opt.hw.board.protocol`; do not edit.
#pragma once
#include <stdint.h>

namespace protocol {

constexpr uint8_t VERSION = 1;
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
  LOOP_HUNG = 2,
  TENSION_TOO_HIGH = 3,
  DYNAMOMETER = 4,
  REGULATOR = 5,
  TRAVEL = 6,
};

enum class Result : uint8_t {
  DONE = 0,
  WRONG_STATE = 1,
  WRONG_SESSION = 2,
  ESTOP_PRESSED = 3,
  DYNAMOMETER = 4,
  UNKNOWN_KEY = 5,
  OUT_OF_RANGE = 6,
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
  uint8_t sequence;
  uint8_t enabled;
  uint16_t pressures[6];
  int16_t tendons[6];
} __attribute__((packed));
static_assert(sizeof(Set) == 27, "");

struct Arm {
  static constexpr uint8_t CODE = 0x02;
  uint8_t code;
  uint8_t id;
  uint8_t session;
  uint8_t sequence;
} __attribute__((packed));
static_assert(sizeof(Arm) == 4, "");

struct Clear {
  static constexpr uint8_t CODE = 0x03;
  uint8_t code;
  uint8_t id;
  uint8_t session;
} __attribute__((packed));
static_assert(sizeof(Clear) == 3, "");

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
  uint8_t key;
  uint16_t value;
} __attribute__((packed));
static_assert(sizeof(Config) == 5, "");

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
  uint8_t sequence;
  uint8_t count;
  uint8_t session;
  uint8_t state;
  uint8_t fault;
  uint8_t channel;
  uint8_t enabled;
  uint16_t good;
  uint16_t bad;
  uint8_t refused;
  uint8_t late;
  uint32_t time_us;
  uint16_t dynamometers[6];
  uint16_t monitors[6];
  int16_t positions[6];
} __attribute__((packed));
static_assert(sizeof(Status) == 54, "");

struct Ack {
  static constexpr uint8_t CODE = 0x82;
  uint8_t code;
  uint8_t id;
  uint8_t request;
  uint8_t result;
  uint8_t state;
  uint8_t session;
} __attribute__((packed));
static_assert(sizeof(Ack) == 6, "");

struct Hello {
  static constexpr uint8_t CODE = 0x83;
  uint8_t code;
  uint8_t version;
  uint8_t channels;
  uint8_t reset_cause;
  uint8_t state;
  uint8_t session;
  uint32_t build;
  uint16_t pressure_max;
  uint16_t tension_max;
  uint8_t timeout_ms;
} __attribute__((packed));
static_assert(sizeof(Hello) == 15, "");

}  // namespace protocol
