#include "dac.h"

#include <avr/interrupt.h>

#include "config.h"
#include "spi.h"

#if DAC == DAC_MCP4922

namespace dac {

void begin() {
  constexpr uint8_t chips = ((1 << (DACS + 1) / 2) - 1) << SELECT_DAC_SHIFT;
  SELECT_PORT |= chips;
  SELECT_DDR |= chips;
  spi::begin();
  for (uint8_t channel = 0; channel < DACS; ++channel) write(channel, 0);
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

}  // namespace dac

#else  // MCP4728: two chips, each with four outputs, written in the background by the interrupt of the two-wire interface

#include <util/delay.h>
#include <util/twi.h>

namespace dac {

static volatile uint16_t codes[8];
static volatile uint8_t chip, byte_at;

static constexpr uint8_t GO = _BV(TWINT) | _BV(TWEN) | _BV(TWIE);

void begin() {
  TWBR = (F_CPU / 400000L - 16) / 2;
  TWSR = 0;
  chip = 0;
  TWCR = GO | _BV(TWSTA);
  _delay_ms(2);  // both chips have forgotten what their own memory told them at power-on
}

void write(uint8_t channel, uint16_t code) {
  const uint8_t status = SREG;
  cli();
  codes[channel < 3 ? channel : channel + 1] = code;  // channels 1-3 on the first chip, 4-6 on the second
  SREG = status;
}

}  // namespace dac

// Fast write: address, then two bytes for each of the outputs A ... D; then the other chip; for ever.
ISR(TWI_vect) {
  using namespace dac;
  switch (TWSR & 0xF8) {
    case TW_START:
    case TW_REP_START:
      byte_at = 0;
      TWDR = (0x60 + chip) << 1;
      TWCR = GO;
      return;
    case TW_MT_SLA_ACK:
    case TW_MT_DATA_ACK:
      if (byte_at < 8) {
        const uint16_t code = codes[4 * chip + byte_at / 2];
        TWDR = byte_at & 1 ? code : code >> 8;  // power-down bits are 0: output on
        ++byte_at;
        TWCR = GO;
        return;
      }
      break;
    default:  // nobody answers, or the bus was lost: try the other chip
      break;
  }
  chip ^= 1;
  TWCR = GO | _BV(TWSTO) | _BV(TWSTA);
}

#endif
