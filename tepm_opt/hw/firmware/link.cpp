#include "fast.h"

#include "link.h"

#include <string.h>

#include "board.h"
#include "config.h"
#include "frames.h"
#include "memory.h"
#include "motors.h"
#include "protocol.h"
#include "uart.h"

using namespace protocol;

namespace {

// What a pass takes in, sums up and sends at most, so that none is late. STATUS needs four passes of the five that it has.
constexpr uint8_t RECEIVED = 13, SUMMED = 32, SENT = 18;

Decoder decoder;
uint16_t good;
uint8_t count;

// The last request and its answer: one that comes again is answered again, not done again.
uint8_t last[sizeof(Config)], last_result, last_channel;
static_assert(sizeof(Config) >= sizeof(Arm), "the longest request");

// What goes out: a payload with its CRC so far, then a frame that trickles into the serial port.
union {
  Status status;
  Ack ack;
  Hello hello;
  Limits limits;
  uint8_t bytes[sizeof(Status) + 2];
} payload;
uint8_t out[sizeof payload + 2];
uint8_t summed, length, sent, out_length;
uint16_t crc;
bool ack_due, hello_due = true, limits_due;
uint16_t since_status, since_hello;
bool heard;

template <typename Message>
const Message *as() {
  return decoder.payload()[0] == Message::CODE && decoder.length() == sizeof(Message) ? (const Message *)decoder.payload() : nullptr;
}

template <typename Message>
bool again(const Message &message) {
  ack_due = true;
  if (!memcmp(last, &message, sizeof message)) return true;
  memcpy(last, &message, sizeof message);
  last_channel = 0;
  return false;
}

void take() {
  if (const Set *message = as<Set>()) {
    board::set(*message);
  } else if (const Arm *message = as<Arm>()) {
    if (!again(*message)) last_result = (uint8_t)board::arm(*message, last_channel);
  } else if (const Clear *message = as<Clear>()) {
    if (!again(*message)) last_result = (uint8_t)board::clear(message->session, last_channel);
  } else if (const Estop *message = as<Estop>()) {
    again(*message);
    last_result = (uint8_t)board::estop();
  } else if (const Disarm *message = as<Disarm>()) {
    again(*message);
    last_result = (uint8_t)board::disarm();
  } else if (const Config *message = as<Config>()) {
    if (!again(*message)) last_result = (uint8_t)board::config(message->session, message->key, message->value);
  } else if (as<Ask>()) {
    hello_due = limits_due = true;
  } else {
    ++decoder.bad;
    return;
  }
  heard = true;
  ++good;
}

void begin_payload(uint8_t size) {
  length = size;
  summed = 0;
  crc = 0xFFFF;
}

void choose() {
  if (ack_due) {
    ack_due = false;
    payload.ack = {Ack::CODE, last[1], last[0], last_result, last_channel, (uint8_t)board::state(), memory::session()};
    begin_payload(sizeof payload.ack);
  } else if (hello_due) {
    hello_due = false;
    payload.hello.code = Hello::CODE;
    board::report(payload.hello);
    begin_payload(sizeof payload.hello);
  } else if (limits_due) {
    limits_due = false;
    payload.limits = LIMITS;
    begin_payload(sizeof payload.limits);
  } else if (since_status >= board::status_passes()) {
    since_status -= board::status_passes();  // one that waits for an answer to go out does not delay those after it
    if (since_status >= board::status_passes()) since_status = 0;
    Status &status = payload.status;
    status.code = Status::CODE;
    board::report(status);
    status.count = count++;
    status.good = good;
    status.bad = decoder.bad;
    begin_payload(sizeof status);
  }
}

}  // namespace

namespace link {

void begin() {
  uart::begin();
  const uint8_t zero = 0;
  uart::put(&zero, 1);  // ends the frame in whose middle a reset came
}

void receive() {
  uint8_t byte;
  for (uint8_t k = 0; k < RECEIVED && uart::take(byte); ++k) {
    if (decoder.take(byte)) take();
    motors::alive();
  }
}

// A frame is made in steps of a pass each: its CRC is summed while the one before it trickles into the serial port. A STATUS takes four
// passes, so that one that had to wait is made up for.
void send() {
  ++since_status;
  if (!heard && ++since_hello >= PASS_HZ / 5) {  // until somebody answers
    since_hello = 0;
    hello_due = true;
  }
  if (length == 0) {
    choose();
  } else if (summed < length) {
    for (uint8_t k = 0; k < SUMMED && summed < length; ++k) crc = crc16(crc, payload.bytes[summed++]);
  } else if (sent == out_length) {
    crc = ~crc;
    payload.bytes[length] = crc >> 8;
    payload.bytes[length + 1] = crc;
    out_length = encode(payload.bytes, length + 2, out);
    sent = length = 0;
  }
  motors::alive();
  if (sent < out_length) {
    uint8_t portion = out_length - sent;
    if (portion > SENT) portion = SENT;
    if (uart::room() < portion) return;
    uart::put(out + sent, portion);
    sent += portion;
    motors::alive();
  }
}

}  // namespace link
