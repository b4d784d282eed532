// The firmware's frames on a PC: its decoder over whole streams, and a seeded generator of streams damaged in every way a line can.
#include "../../../tepm_opt/hw/firmware/frames.cpp"

#include <string.h>

enum { WIDTH = 64, CHUNK = 640 };

static uint64_t state;

static uint32_t draw(uint32_t below) {  // splitmix64
  uint64_t z = state += 0x9E3779B97F4A7C15ull;
  z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ z >> 27) * 0x94D049BB133111EBull;
  return (uint32_t)((z ^ z >> 31) >> 32) % below;
}

static uint32_t write_frame(const uint8_t *payload, uint8_t length, uint8_t *out) {
  uint8_t content[WIDTH + 2];
  uint16_t crc = 0xFFFF;
  memcpy(content, payload, length);
  for (uint8_t k = 0; k < length; ++k) crc = crc16(crc, payload[k]);
  crc = ~crc;
  content[length] = crc >> 8;
  content[length + 1] = crc;
  return encode(content, length + 2, out);
}

// A payload of one of the kinds in `sizes` (by code; 0: no such kind); three of four SETs are within the limits.
static uint8_t write_payload(const uint8_t *sizes, uint8_t *payload) {
  uint8_t code;
  do code = draw(256);
  while (!sizes[code]);
  memset(payload, 0, WIDTH);
  payload[0] = code;
  const bool sparse = draw(2), allowed = draw(4);
  for (uint8_t k = 1; k < sizes[code]; ++k) payload[k] = sparse && draw(2) ? 0 : draw(256);
  if (code == 1 && allowed) {
    payload[9] &= 0xBF;
    for (uint8_t k = 11; k < sizes[code]; k += 2) payload[k] &= 7;
  }
  return sizes[code];
}

static uint32_t damage(uint8_t *bytes, uint32_t count) {
  for (uint32_t times = 1 + draw(3); times; --times) {
    const uint32_t at = count ? draw(count) : 0;
    switch (draw(9)) {
      case 0:  // bits flip
      case 1:
        for (uint32_t k = 1 + draw(4); k && count; --k) bytes[draw(count)] ^= 1 << draw(8);
        break;
      case 2:  // a byte is lost
        if (count) memmove(bytes + at, bytes + at + 1, --count - at);
        break;
      case 3:  // twice
        if (count) memmove(bytes + at + 1, bytes + at, count++ - at);
        break;
      case 4:  // one more
        memmove(bytes + at + 1, bytes + at, count++ - at);
        bytes[at] = draw(256);
        break;
      case 5:  // the end is missing
        count = at;
        break;
      case 6:  // the beginning is missing
        memmove(bytes, bytes + at, count -= at);
        break;
      case 7:  // the end of the frame is missing: it grows together with the next
        if (count) --count;
        break;
      default:  // garbage instead of the rest
        for (uint32_t k = draw(60); k && count < 300; --k) bytes[count++] = draw(256);
        bytes[count++] = 0;
    }
  }
  return count;
}

extern "C" {

uint32_t frame(const uint8_t *payload, uint8_t length, uint8_t *out) { return write_frame(payload, length, out); }

// Groups of a damaged frame and some whole ones. Chunk k ends at ends[k] and was made of payloads[WIDTH * k].
uint32_t stream(uint64_t seed, uint32_t groups, uint32_t whole, const uint8_t *sizes, uint8_t *out, uint32_t *ends, uint8_t *payloads) {
  state = seed;
  uint32_t length = 0, chunk = 0;
  for (uint32_t group = 0; group < groups; ++group) {
    for (uint32_t k = 0; k <= whole; ++k, ++chunk) {
      uint8_t bytes[CHUNK], *payload = payloads + WIDTH * chunk;
      const uint8_t size = write_payload(sizes, payload);
      uint32_t count = write_frame(payload, size, bytes);
      if (k == 0) {
        uint8_t before[CHUNK];
        const uint32_t was = count;
        memcpy(before, bytes, count);
        do {
          memcpy(bytes, before, was);
          count = damage(bytes, was);
        } while (count == was && !memcmp(bytes, before, was));
      }
      memcpy(out + length, bytes, count);
      ends[chunk] = length += count;
    }
  }
  return length;
}

void *decoder_new() { return new Decoder; }

void decoder_free(void *decoder) { delete (Decoder *)decoder; }

uint16_t decoder_bad(void *decoder) { return ((Decoder *)decoder)->bad; }

// Returns how many frames were right: where each ended, its length, and its payload in WIDTH bytes, filled up with zeros.
uint32_t decode(void *decoder, const uint8_t *bytes, uint32_t count, uint32_t *at, uint8_t *lengths, uint8_t *payloads) {
  Decoder *it = (Decoder *)decoder;
  uint32_t found = 0;
  for (uint32_t k = 0; k < count; ++k) {
    if (!it->take(bytes[k])) continue;
    at[found] = k;
    lengths[found] = it->length();
    memset(payloads + WIDTH * found, 0, WIDTH);
    memcpy(payloads + WIDTH * found++, it->payload(), it->length());
  }
  return found;
}

}  // extern "C"
