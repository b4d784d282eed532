// Firmware of the control board: six pressures out, six tendons held, and a hand on the plug.
#include "fast.h"

#include <Arduino.h>
#include <avr/wdt.h>

#include "board.h"
#include "link.h"
#include "motors.h"

static uint8_t reset_cause __attribute__((section(".noinit")));

// Before main(): a watchdog that has bitten stays on until it is told otherwise.
extern "C" void remember_reset(void) __attribute__((naked, used, section(".init3")));
extern "C" void remember_reset(void) {
  reset_cause = MCUSR;
  MCUSR = 0;
  wdt_disable();
}

void setup() {
  board::begin(reset_cause);
  link::begin();
  wdt_enable(WDTO_120MS);
}

// A function of its own, so that waiting for its time saves no registers.
static __attribute__((noinline)) void pass() {
  wdt_reset();
  link::receive();
  motors::alive();
  board::pass();
  motors::alive();
  link::send();
}

__attribute__((noinline)) void loop() {
  motors::alive();
  if (motors::pass_due()) pass();
}
