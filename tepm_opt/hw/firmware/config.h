// What a lab changes: which converters, which pins, which limits. Everything is checked when it is compiled.
#pragma once
#include <stdint.h>

#ifdef LIMITS_H  // make LIMITS=FILE
#include LIMITS_H
#else
#include "limits.h"
#endif

// ---------------------------------------------------------------- parts

// Pressure set points: DAC_MCP4922 (SPI, two outputs a chip; recommended: its SHDN pin switches the outputs off in hardware)
// or DAC_MCP4728 (I2C, four outputs a chip, addresses 0x60 and 0x61).
#define DAC_MCP4922 1
#define DAC_MCP4728 2
#ifndef DAC
#define DAC DAC_MCP4922
#endif

// Dynamometers: ADC_AD7606 (SPI, 16 bits, +-5 V range: 0.31 mN at 0.5 V/N) or ADC_INTERNAL (10 bits, oversampled to about 12).
#define ADC_AD7606 1
#define ADC_INTERNAL 2
#ifndef ADC_TENSION
#if defined(__AVR_ATmega328P__)
#define ADC_TENSION ADC_INTERNAL
#else
#define ADC_TENSION ADC_AD7606
#endif
#endif

#ifndef BAUD
#define BAUD 250000L  // exact at 16 MHz; 115200 also works, with STATUS at 100 Hz
#endif

// ---------------------------------------------------------------- limits that no calibration changes. Those of the robot: limits.h

constexpr uint16_t DYNAMOMETER_HIGH = 31130;     // 4.75 V: above is a broken wire of the bridge
constexpr int16_t TRAVEL_MAX = 30000;            // steps; a loop that winds further pulls at nothing: FAULT

// ---------------------------------------------------------------- motion. A pass of the main loop is a millisecond

constexpr uint16_t PASS_HZ = 1000;
constexpr uint8_t TICKS = 20;                    // of the step interrupt in a pass
constexpr uint8_t STEPS_MAX = TICKS / 2;         // in a pass: every second tick
constexpr uint8_t PATIENCE = 8;                  // ticks without a sign of the main loop: no steps any more, at most 4 were made
constexpr float STEP_RATE_HZ = 9524.0f;          // 10 N/s
// The motors start, stop and turn round without a ramp up to here (pull-in rate): 500 full steps a second at 16 microsteps, what a lightly
// loaded NEMA 17 does. A controller gives set points 100 times a second; with slower ramps the motor would brake for every one of them.
constexpr float STEP_START_HZ = 8000.0f;
constexpr float STEP_ACCELERATION_HZ_S = 1600000.0f;
constexpr float PRESSURE_SLEW_MPA_S = 2.5f;      // of set points while armed
constexpr float PRESSURE_RAMP_MPA_S = 1.0f;      // to zero, when the host is silent or something is wrong
#if ADC_TENSION == ADC_INTERNAL
constexpr uint8_t TENSION_DEAD_BAND = 8;         // counts: its noise
#else
constexpr uint8_t TENSION_DEAD_BAND = 2;         // counts: a little more than half a step
#endif

// ---------------------------------------------------------------- how long something has to be wrong, in ms by the clock

constexpr uint16_t TIMEOUT_MS = 100;             // no SET
constexpr uint16_t REGULATOR_MS = 1500;          // a monitor further off its set point than LIMITS.regulator_band
constexpr uint16_t MONITOR_MS = 50;              // a monitor above LIMITS.monitor_trip, or broken
constexpr uint16_t BUS_MS = 20;                  // the two-wire bus of the MCP4728

// ---------------------------------------------------------------- pins (port letters, bits). docs/how-to/hardware.md has the drawing

#if defined(__AVR_ATmega2560__)
constexpr uint8_t MOTORS = 6, DACS = 6, MONITORS = 6;
#define STEP_PORT PORTA  // 22 ... 27
#define STEP_DDR DDRA
#define STEP_SHIFT 0
#define DIR_PORT PORTC  // 37 ... 32
#define DIR_DDR DDRC
#define DIR_SHIFT 0
#define ENA_PORT PORTL  // 49 ... 44; low enables
#define ENA_DDR DDRL
#define ENA_SHIFT 0
#define SELECT_PORT PORTH
#define SELECT_DDR DDRH
#define SELECT_DAC_SHIFT 3  // 6, 7, 8: MCP4922 of channels 1-2, 3-4, 5-6
#define SELECT_ADC 6        // 9: AD7606
#define CONTROL_PORT PORTG
#define CONTROL_DDR DDRG
#define CONVERT_BIT 0       // 41: CONVST of the AD7606
#define OUTPUTS_BIT 1       // 40: high lets the DACs and the dump valve work; pulled down outside
#define ESTOP_PIN PINE
#define ESTOP_PORT PORTE
#define ESTOP_BIT 4         // 2: a closed contact to ground; open or broken is pressed
#define MONITOR_FIRST 0     // A0 ... A5
#define DYNAMOMETER_FIRST 8 // A8 ... A13, with ADC_INTERNAL
#elif defined(__AVR_ATmega328P__)
// An Uno has the pins for one module: three motors, three regulators, no monitors.
constexpr uint8_t MOTORS = 3, DACS = 3, MONITORS = 0;
#define STEP_PORT PORTD  // 2, 3, 4
#define STEP_DDR DDRD
#define STEP_SHIFT 2
#define DIR_PORT PORTD  // 5, 6, 7
#define DIR_DDR DDRD
#define DIR_SHIFT 5
#define ENA_PORT PORTC  // A3, A4, A5; low enables
#define ENA_DDR DDRC
#define ENA_SHIFT 3
#define SELECT_PORT PORTB
#define SELECT_DDR DDRB
#define SELECT_DAC_SHIFT 1  // 9, 10
#define SELECT_ADC 7        // none
#define CONTROL_PORT PORTB
#define CONTROL_DDR DDRB
#define CONVERT_BIT 7       // none
#define OUTPUTS_BIT 0       // 8
#define ESTOP_PIN PINB
#define ESTOP_PORT PORTB
#define ESTOP_BIT 4         // 12: MISO, which is an input whatever DDRB says
#define MONITOR_FIRST 0
#define DYNAMOMETER_FIRST 0 // A0, A1, A2
#if DAC != DAC_MCP4922 || ADC_TENSION != ADC_INTERNAL
#error "An Uno has pins for MCP4922 and its own converter only"
#endif
#else
#error "no pins for this board: add them here"
#endif

static_assert(LIMITS.pressure_max < 4096, "the DAC ends before pressure_max");
static_assert(LIMITS.code_zero < (int16_t)LIMITS.pressure_max, "no pressure between code_zero and pressure_max");
static_assert(LIMITS.monitor_low < LIMITS.monitor_zero || LIMITS.monitor_low == 0, "no live zero");
static_assert(LIMITS.monitor_trip < 32736, "the monitors end before monitor_trip");
static_assert(LIMITS.tension_max < LIMITS.tension_trip && LIMITS.tension_trip < DYNAMOMETER_HIGH, "the dynamometers end before tension_trip");
static_assert(LIMITS.dynamometer_low < LIMITS.tension_zero, "no live zero");
static_assert(STEP_RATE_HZ <= (float)PASS_HZ * STEPS_MAX, "more steps than the interrupt can make");
static_assert(LIMITS.position_max < TRAVEL_MAX, "TRAVEL_MAX stops the motor before the largest tension");
