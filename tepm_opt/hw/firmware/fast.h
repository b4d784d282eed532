// First in every source. The Arduino IDE and PlatformIO compile for size, and then a pass of the main loop can take more than its millisecond.
#pragma once

#ifdef __AVR__
#ifndef __OPTIMIZE__
#error "without optimisation the main loop is late: compile with -Os or -O2"
#endif
#pragma GCC optimize("O2")
#endif
