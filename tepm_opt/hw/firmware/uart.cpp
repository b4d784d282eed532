#include "fast.h"

#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>

#include "config.h"

#if defined(USART0_RX_vect)
#define RECEIVED_vect USART0_RX_vect
#define EMPTY_vect USART0_UDRE_vect
#else
#define RECEIVED_vect USART_RX_vect
#define EMPTY_vect USART_UDRE_vect
#endif

// Rings of a power of two: one side writes, the other reads; a byte's index is one byte, so that neither side has to lock the other out.
static constexpr uint8_t SIZE = 128, MASK = SIZE - 1;
static uint8_t in[SIZE], out[SIZE];
static volatile uint8_t in_head, in_tail, out_head, out_tail;

ISR(RECEIVED_vect) {
  const uint8_t byte = UDR0, head = in_head, after = (head + 1) & MASK;
  if (after == in_tail) return;  // lost: the frame's CRC will say so
  in[head] = byte;
  in_head = after;
}

ISR(EMPTY_vect) {
  const uint8_t tail = out_tail, after = (tail + 1) & MASK;
  UDR0 = out[tail];
  out_tail = after;
  if (after == out_head) UCSR0B &= ~_BV(UDRIE0);
}

namespace uart {

void begin() {
  UCSR0A = _BV(U2X0);
  UBRR0 = (F_CPU / 4 / BAUD - 1) / 2;
  UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
  UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

bool take(uint8_t &byte) {
  const uint8_t tail = in_tail;
  if (tail == in_head) return false;
  byte = in[tail];
  in_tail = (tail + 1) & MASK;
  return true;
}

uint8_t room() { return (out_tail - out_head - 1) & MASK; }

void put(const uint8_t *bytes, uint8_t count) {
  uint8_t head = out_head;
  for (; count; --count) {
    out[head] = *bytes++;
    head = (head + 1) & MASK;
  }
  const uint8_t status = SREG;
  cli();
  out_head = head;
  UCSR0B |= _BV(UDRIE0);
  SREG = status;
}

}  // namespace uart
