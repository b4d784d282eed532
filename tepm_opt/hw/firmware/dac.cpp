#include "fast.h"

#include "dac.h"

#include <avr/interrupt.h>

#include "config.h"
#include "spi.h"

#if DAC == DAC_MCP4922

namespace dac {

bool begin() {
  constexpr uint8_t chips = ((1 << (DACS + 1) / 2) - 1) << SELECT_DAC_SHIFT;
  SELECT_PORT |= chips;
  SELECT_DDR |= chips;
  spi::begin();
  for (uint8_t channel = 0; channel < DACS; ++channel) write(channel, 0);
  return true;
}

void write(uint8_t channel, uint16_t code) {
  // output A or B, unbuffered reference, gain 1, output on
  const uint16_t word = ((channel & 1) ? 0xB000 : 0x3000) | code;
  const uint8_t select = 1 << (SELECT_DAC_SHIFT + channel / 2);
  SPCR = spi::MODE_0;
  SELECT_PORT &= ~select;
  spi::exchange(word >> 8);
  spi::exchange(word);
  SELECT_PORT |= select;
}

void turn(uint32_t) {}

bool hung() { return false; }  // nothing on this bus answers

}  // namespace dac

#else  // MCP4728: two chips, each with four outputs. The interrupt of the two-wire interface writes one output after the other

#include <util/delay.h>
#include <util/twi.h>

namespace dac {

// The main loop starts a write each pass, round the channels; an output is written again every DACS passes, whether it has changed or not.
static volatile uint16_t codes[DACS];
static uint16_t code;  // that is on its way
static volatile uint8_t channel, byte_at;
static volatile bool busy;
static volatile uint8_t arrived;  // bits of the chips
static uint32_t turned, started;  // the clock at the last turn; when the last write began
static uint8_t waited[2];         // ms since a write arrived at each, as far as somebody was there to write
static bool hung_;

static constexpr uint8_t GO = _BV(TWINT) | _BV(TWEN) | _BV(TWIE);

static constexpr uint8_t CHIPS = (DACS + 2) / 3, RETRY_MS = BUS_MS / 4;
static constexpr uint8_t SCL_BIT = 0, SDA_BIT = 1;  // of port D: 21, 20

// A chip that a reset caught in the middle of its answer holds SDA low until it has been clocked through; nobody else can be heard then.
static void release() {
  TWCR = 0;
  for (uint8_t k = 0; k < 9 && !(PIND & _BV(SDA_BIT)); ++k) {
    DDRD |= _BV(SCL_BIT);  // low; the resistor pulls it up again
    _delay_us(2);
    DDRD &= ~_BV(SCL_BIT);
    _delay_us(2);
  }
}

bool begin() {
  release();
  TWBR = (F_CPU / 400000L - 16) / 2;
  TWSR = 0;
  uint8_t missing = DACS;
  for (channel = 0; channel < DACS; ++channel) {  // the chips' own memory told them something else at power-on
    arrived = 0;
    TWCR = GO | _BV(TWSTA);
    _delay_us(200);
    if (arrived) --missing;
  }
  TWCR = 0;
  channel = 0;
  return missing == 0;
}

void write(uint8_t at, uint16_t code) {
  const uint8_t status = SREG;
  cli();
  codes[at] = code;
  SREG = status;
}

void turn(uint32_t now) {
  const uint8_t gap = now - turned < RETRY_MS ? now - turned : RETRY_MS;
  turned = now;
  hung_ = false;
  for (uint8_t chip = 0; chip < CHIPS; ++chip) {
    if (arrived & 1 << chip) waited[chip] = 0;
    else if (waited[chip] <= BUS_MS) waited[chip] += gap;
    hung_ |= waited[chip] > BUS_MS;
  }
  if (busy && now - started <= RETRY_MS) return;
  release();
  arrived = 0;
  channel = channel + 1 < DACS ? channel + 1 : 0;
  busy = true;
  started = now;
  TWCR = GO | _BV(TWSTA);
}

bool hung() { return hung_; }

}  // namespace dac

// Multi-write: address; output; reference (the supply), power (on), gain (1) and the upper bits of the code; the lower ones.
ISR(TWI_vect) {
  using namespace dac;
  switch (TWSR & 0xF8) {
    case TW_START:
      byte_at = 0;
      TWDR = (0x60 + channel / 3) << 1;  // channels 1-3 on the first chip, 4-6 on the second
      TWCR = GO;
      return;
    case TW_MT_SLA_ACK:
    case TW_MT_DATA_ACK:
      if (byte_at < 3) {
        if (byte_at == 0) code = codes[channel];
        TWDR = byte_at == 0 ? 0x40 | (channel % 3) << 1 : byte_at == 1 ? code >> 8 : code;
        ++byte_at;
        TWCR = GO;
        return;
      }
      arrived |= 1 << channel / 3;
      break;
    default:  // nobody answers, or the bus was lost
      break;
  }
  busy = false;
  TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
}

#endif
