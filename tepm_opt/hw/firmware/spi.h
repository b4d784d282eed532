// The SPI bus at 8 MHz, polled: a byte takes 1 us, less than an interrupt would.
#pragma once
#include <avr/io.h>

#include "config.h"

namespace spi {

constexpr uint8_t MODE_0 = _BV(SPE) | _BV(MSTR);              // MCP4922
constexpr uint8_t MODE_2 = _BV(SPE) | _BV(MSTR) | _BV(CPOL);  // AD7606

inline uint8_t exchange(uint8_t byte) {
  SPDR = byte;
  while (!(SPSR & _BV(SPIF))) {
  }
  return SPDR;
}

inline void begin() {
#if defined(__AVR_ATmega2560__)
  DDRB |= _BV(0) | _BV(1) | _BV(2);  // SS as an output keeps the bus master; SCK, MOSI
#else
  DDRB |= _BV(2) | _BV(3) | _BV(5);
#endif
  SPSR = _BV(SPI2X);
  SPCR = MODE_0;
}

}  // namespace spi
