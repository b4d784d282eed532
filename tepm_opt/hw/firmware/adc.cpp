#include "fast.h"

#include "adc.h"

#include <avr/interrupt.h>
#include <avr/io.h>

#include "config.h"
#include "spi.h"

// The processor's own converter goes round its channels; its interrupt adds up 16 conversions of each: about 12 bits.
static constexpr uint8_t OVERSAMPLING = 16;
#if ADC_TENSION == ADC_INTERNAL
static constexpr uint8_t INTERNAL = MONITORS + MOTORS;
#else
static constexpr uint8_t INTERNAL = MONITORS;
#endif
static volatile uint16_t sums[INTERNAL ? INTERNAL : 1];
static volatile uint8_t at, conversion;
static volatile uint8_t fresh_;  // bits of the dynamometers
static uint16_t external[MOTORS];

static void select(uint8_t channel) {
  const uint8_t input = channel < MONITORS ? MONITOR_FIRST + channel : DYNAMOMETER_FIRST + channel - MONITORS;
  ADMUX = _BV(REFS0) | (input & 7);
#ifdef MUX5
  ADCSRB = input & 8 ? _BV(MUX5) : 0;
#endif
}

ISR(ADC_vect) {
  static uint16_t sum;
  sum += ADC;
  if (++conversion == OVERSAMPLING) {
    conversion = 0;
    sums[at] = sum;
    if (at >= MONITORS) fresh_ |= 1 << (at - MONITORS);
    sum = 0;
    at = at + 1 < INTERNAL ? at + 1 : 0;
    select(at);
  }
  ADCSRA |= _BV(ADSC);
}

static uint16_t counts(uint8_t channel) {
  const uint8_t status = SREG;
  cli();
  const uint16_t sum = sums[channel];
  SREG = status;
  return 2 * sum;
}

namespace adc {

void begin() {
#if ADC_TENSION == ADC_AD7606
  SELECT_PORT |= _BV(SELECT_ADC);
  SELECT_DDR |= _BV(SELECT_ADC);
  CONTROL_PORT |= _BV(CONVERT_BIT);
  CONTROL_DDR |= _BV(CONVERT_BIT);
  spi::begin();
#endif
  if (INTERNAL == 0) return;
  select(0);
  ADCSRA = _BV(ADEN) | _BV(ADIE) | _BV(ADSC) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);  // 104 us a conversion
}

void convert() {
#if ADC_TENSION == ADC_AD7606
  CONTROL_PORT &= ~_BV(CONVERT_BIT);
  CONTROL_PORT |= _BV(CONVERT_BIT);
#endif
}

void read() {
#if ADC_TENSION == ADC_AD7606
  SPCR = spi::MODE_2;
  SELECT_PORT &= ~_BV(SELECT_ADC);
  for (uint8_t channel = 0; channel < MOTORS; ++channel) {
    const uint8_t high = spi::exchange(0);
    const uint16_t value = (uint16_t)high << 8 | spi::exchange(0);
    external[channel] = value & 0x8000 ? 0 : value;  // below 0 V
  }
  SELECT_PORT |= _BV(SELECT_ADC);
#else
  for (uint8_t channel = 0; channel < MOTORS; ++channel) external[channel] = counts(MONITORS + channel);
#endif
}

uint8_t fresh() {
#if ADC_TENSION == ADC_AD7606
  return 0xFF;
#else
  const uint8_t status = SREG;
  cli();
  const uint8_t bits = fresh_;
  fresh_ = 0;
  SREG = status;
  return bits;
#endif
}

uint16_t dynamometer(uint8_t channel) { return external[channel]; }

uint16_t monitor(uint8_t channel) { return channel < MONITORS ? counts(channel) : 0; }

}  // namespace adc
