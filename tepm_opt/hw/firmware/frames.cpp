#include "fast.h"

#include "frames.h"

#ifdef __AVR__
#include <util/crc16.h>
uint16_t crc16(uint16_t crc, uint8_t byte) { return _crc_xmodem_update(crc, byte); }
#else
uint16_t crc16(uint16_t crc, uint8_t byte) {
  crc ^= (uint16_t)byte << 8;
  for (uint8_t bit = 0; bit < 8; ++bit) crc = crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1;
  return crc;
}
#endif

static constexpr uint16_t RIGHT = 0x1D0F;  // what the sum is after payload and inverted CRC

void Decoder::begin() {
  left_ = 0;
  crc_ = 0xFFFF;
  zero_ = broken_ = false;
  empty_ = true;
}

bool Decoder::finish() {
  const bool whole = !empty_ && !broken_ && left_ == 0 && length_ > 2 && crc_ == RIGHT;
  if (!whole && !empty_) ++bad;
  if (whole) length_ -= 2;
  begin();
  return whole;
}

bool Decoder::take(uint8_t byte) {
  if (byte == 0) return finish();
  if (empty_) {  // a new frame: the buffer of the last one is free now
    empty_ = false;
    length_ = 0;
    left_ = byte - 1;
    zero_ = byte != 0xFF;
    return false;
  }
  uint8_t value = byte;
  if (left_ == 0) {  // a code byte: the zero that it stands for comes first
    left_ = byte - 1;
    const bool zero = zero_;
    zero_ = byte != 0xFF;
    if (!zero) return false;
    value = 0;
  } else {
    --left_;
  }
  if (length_ >= LONGEST) {
    broken_ = true;
    return false;
  }
  buffer_[length_++] = value;
  crc_ = crc16(crc_, value);
  return false;
}

uint8_t encode(const uint8_t *content, uint8_t length, uint8_t *out) {
  uint8_t code_at = 0, end = 1;
  for (uint8_t k = 0; k < length; ++k) {
    if (content[k] == 0) {
      out[code_at] = end - code_at;
      code_at = end++;
    } else {
      out[end++] = content[k];
    }
  }
  out[code_at] = end - code_at;
  out[end++] = 0;
  return end;
}
