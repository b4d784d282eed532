// The tendon motors. The main loop writes, pass by pass, when each motor steps within the next millisecond; the interrupt plays that, and
// only as long as the main loop gives signs of life: without one for PATIENCE ticks it switches everything off by itself.
#pragma once
#include <stdint.h>

#include "config.h"

namespace motors {

void begin();
bool pass_due();   // a pass began: the next one has to be written
uint8_t missed();  // passes for which nothing was written in time
uint32_t time();   // passes since the start
void alive();      // a sign of life
bool hung();       // there was none for too long
void forgive();

void enable(uint8_t bits);  // ENA of each motor; one that is switched on counts from 0 anew
uint8_t enabled();
int16_t position(uint8_t motor);

void plan();                              // begins to write the next pass
// In 1/256 step from where the motor will be: it goes that way as fast as its limits allow; gently where the distance is measured anew in
// every pass, a little late.
void to(uint8_t motor, int32_t distance, bool gently);
void commit();                            // the pass is written

extern uint32_t rate_max;  // steps a pass, 16 fractional bits

}  // namespace motors
