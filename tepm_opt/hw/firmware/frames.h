// Frames on the line: COBS(payload + CRC-16/GENIBUS), zero. No Arduino in here: the tests also compile it for a PC.
#pragma once
#include <stdint.h>

uint16_t crc16(uint16_t crc, uint8_t byte);

// Takes bytes one by one; whatever arrives, it never writes outside its buffer and is ready again after the next zero.
class Decoder {
 public:
  static constexpr uint8_t LONGEST = 64;  // payload and CRC

  // True when this byte completes a frame whose CRC is right; then payload() and length() are valid until the next call.
  bool take(uint8_t byte);
  const uint8_t *payload() const { return buffer_; }
  uint8_t length() const { return length_; }  // without the CRC
  uint16_t bad = 0;                           // frames that were not

 private:
  bool finish();
  void begin();

  uint8_t buffer_[LONGEST];
  uint8_t length_ = 0;
  uint8_t left_ = 0;      // bytes until the next code byte
  bool zero_ = false;     // whether a zero stands at that place
  bool empty_ = true;     // nothing since the last zero
  bool broken_ = false;
  uint16_t crc_ = 0xFFFF;
};

// Writes the frame of at most 250 bytes (payload and CRC); returns its length with the zero at its end.
uint8_t encode(const uint8_t *content, uint8_t length, uint8_t *out);
