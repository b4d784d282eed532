// The control board on a desk: simavr's ATmega with what is wired to it. Built twice: as a library that a test drives in lock step, in
// virtual time, and (with -DPROGRAM) as a program with a pseudo-terminal that runs in real time.
//
// simavr 1.6 takes 100 us for a byte on SPI, 9 us for one on the two-wire bus, 11 bits for one on the UART and knows 8 of the Mega's 16
// analog inputs. Here they take what the data sheet says.
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <avr_ioport.h>
#include <avr_twi.h>
#include <avr_uart.h>
#include <avr_watchdog.h>
#include <sim_avr.h>
#include <sim_elf.h>
#include <sim_io.h>

#define CHANNELS 6
#define PIND 0x29
#define DDRD 0x2A
#define TIMSK1 0x6F
#define TWBR 0xB8
#define TWSR 0xB9
#define TWDR 0xBB
#define TWCR 0xBC
#define HZ 16000000ull
#define SLOW_EVERY 1600
#define LOG_LENGTH (1 << 16)
#define SENT_LENGTH (1 << 18)

typedef struct {
  uint16_t port, ddr;
  uint8_t shift;
} Pins;

typedef struct {
  const char *mcu;
  int channels;
  Pins step, dir, ena, select_dac, select_adc, convert, outputs;
  uint16_t estop_pin;
  uint8_t estop_bit;
  int first_dynamometer;  // analog input, where the board's own converter is used
  uint16_t sreg_spdr, spcr, spsr, adcl, adch, admux, adcsrb, mcusr, ucsra, ubrrl, ubrrh;
  uint16_t spi_ddr;
  uint8_t spi_outputs, miso;  // bits: SS, SCK and MOSI have to be outputs; MISO is an input as long as SPI is on
} Wiring;

static const Wiring WIRINGS[] = {
    {"atmega2560", 6, {0x22, 0x21, 0}, {0x28, 0x27, 0}, {0x10B, 0x10A, 0}, {0x102, 0x101, 3}, {0x102, 0x101, 6}, {0x34, 0x33, 0},
     {0x34, 0x33, 1}, 0x2C, 4, 8, 0x4E, 0x4C, 0x4D, 0x78, 0x79, 0x7C, 0x7B, 0x54, 0xC0, 0xC4, 0xC5, 0x24, 0x07, 0x08},
    {"atmega328p", 3, {0x2B, 0x2A, 2}, {0x2B, 0x2A, 5}, {0x28, 0x27, 3}, {0x25, 0x24, 1}, {0x25, 0x24, 7}, {0x25, 0x24, 7},
     {0x25, 0x24, 0}, 0x23, 4, 0, 0x4E, 0x4C, 0x4D, 0x78, 0x79, 0x7C, 0x7B, 0x54, 0xC0, 0xC4, 0xC5, 0x24, 0x2C, 0x10},
};

typedef struct {
  uint64_t cycle;
  int32_t channel, value;
} Event;

typedef struct {
  Event *events;
  uint32_t begin, end;  // end - begin of them; the oldest are overwritten
} Log;

// What is on the pins when a pass of the main loop has read what came and begins to look at its inputs; or that the processor was reset;
// or that the clock of its main loop is about to begin.
enum { PASS, RESET, CLOCK };
typedef struct {
  uint64_t cycle;
  uint32_t delivered;                       // bytes that had reached the UART
  uint8_t kind, enabled, outputs, pressed;
  int16_t dynamometers[CHANNELS];           // what the AD7606 holds
  uint16_t monitors[CHANNELS], dac[CHANNELS];
} Pass;
#define PASSES_LENGTH (1 << 13)

typedef struct Board {
  avr_t *avr;
  avr_uart_t *uart;
  const Wiring *wiring;
  unsigned seed;
  uint8_t levels_step, levels_dir, levels_select, levels_convert, levels_outputs;

  // line to the board
  uint8_t sent[SENT_LENGTH];
  uint32_t sent_begin, sent_end;
  uint64_t next_byte;
  uint32_t line_bits_per_s;
  // line from the board
  Log received;

  // converters
  uint8_t spi_out, spi_in;
  uint16_t dac_word;
  int dac_bytes;
  uint16_t dac_register[8];
  uint16_t dac_memory;  // what the MCP4728 give at power-on
  uint8_t adc_at;
  int16_t adc_latched[CHANNELS];
  uint64_t adc_ready;
  double noise;
  avr_twi_t *twi;
  uint8_t twi_address, twi_bytes, twi_command, twi_word, twi_byte, twi_absent, twi_stuck;
  int twi_hung, twi_sends, twi_bit;  // whether a byte is on its way; whether the next byte is an address

  // what is measured
  int estop_pressed;
  int follows;  // monitors and dynamometers follow what the board does
  int tendons;    // they run free while their motor is off, and cannot be pushed
  int64_t unwound[CHANNELS];  // where each motor stood when its tendon last ran free
  uint16_t held;  // bits of dynamometers (0 ... 5) and monitors (8 ... 13) that do not
  double monitor_V[CHANNELS];
  int32_t dynamometer[CHANNELS];  // counts of 15 bits over 5 V
  double counts_per_step;

  int64_t position[CHANNELS];  // steps while enabled
  uint64_t steps[CHANNELS];    // all of them
  uint64_t idle_steps;         // while not enabled
  Log step_log, dir_log, dac_log;
  uint16_t dac_peak[CHANNELS];
  Pass *passes;
  uint32_t passes_begin, passes_end;
  uint32_t delivered;
  void (*core_reset)(avr_t *);

  // what the program does
  uint32_t slow;               // cycles of each SLOW_EVERY that are taken from it
  uint64_t next_slow;
  uint32_t stop_pc;            // `board_run` ends there
  uint16_t sign;               // address of the variable to which the main loop writes its signs of life; 0: none is watched
  uint32_t loop_pc;
  uint16_t shared, shared_length;  // what an interrupt changes, and how often it was read with interrupts on
  uint64_t unguarded;
  uint64_t last_sign, worst_gap, last_loop, longest_loop, idle, loops;
} Board;

static void log_event(Log *log, uint64_t cycle, int32_t channel, int32_t value) {
  log->events[log->end % LOG_LENGTH] = (Event){cycle, channel, value};
  if (++log->end - log->begin > LOG_LENGTH) log->begin = log->end - LOG_LENGTH;
}

static uint8_t level(Board *board, const Pins *pins) {
  const Wiring *wiring = board->wiring;
  const uint8_t *data = board->avr->data;
  const int spi_on = pins->ddr == wiring->spi_ddr && data[wiring->spcr] & 0x40;
  return data[pins->port] & data[pins->ddr] & (spi_on ? (uint8_t)~wiring->miso : 0xFF);
}

static int outputs_on(Board *board) { return level(board, &board->wiring->outputs) >> board->wiring->outputs.shift & 1; }

uint8_t board_enabled(Board *board) {  // low enables; pulled up outside
  const Pins *ena = &board->wiring->ena;
  const uint8_t high = board->avr->data[ena->port] | (uint8_t)~board->avr->data[ena->ddr];
  return (uint8_t)~high >> ena->shift & ((1 << board->wiring->channels) - 1);
}

uint16_t board_dac(Board *board, int channel) {
  const uint16_t word = board->dac_register[channel];
  return outputs_on(board) && word & 0x1000 ? word & 0x0FFF : 0;
}

static void dac_changed(Board *board, int channel) {
  const uint16_t code = board_dac(board, channel);
  log_event(&board->dac_log, board->avr->cycle, channel, code);
  if (code > board->dac_peak[channel]) board->dac_peak[channel] = code;
}

static void steps_changed(Board *board) {
  const Wiring *wiring = board->wiring;
  const uint8_t mask = (1 << wiring->channels) - 1;
  const uint8_t now = level(board, &wiring->step) >> wiring->step.shift & mask;
  const uint8_t rising = now & ~board->levels_step, direction = level(board, &wiring->dir) >> wiring->dir.shift;
  const uint8_t enabled = board_enabled(board);
  board->levels_step = now;
  for (int k = 0; rising >> k; ++k) {
    if (!(rising >> k & 1)) continue;
    const int sign = direction >> k & 1 ? 1 : -1;
    ++board->steps[k];
    if (enabled >> k & 1) board->position[k] += sign;
    else ++board->idle_steps;
    log_event(&board->step_log, board->avr->cycle, k, sign);
  }
}

static void directions_changed(Board *board) {
  const Wiring *wiring = board->wiring;
  const uint8_t now = level(board, &wiring->dir) >> wiring->dir.shift & ((1 << wiring->channels) - 1), changed = now ^ board->levels_dir;
  board->levels_dir = now;
  for (int k = 0; changed >> k; ++k)
    if (changed >> k & 1) log_event(&board->dir_log, board->avr->cycle, k, now >> k & 1 ? 1 : -1);
}

static void selects_changed(Board *board) {
  const Wiring *wiring = board->wiring;
  const uint16_t port = wiring->select_dac.port, ddr = wiring->select_dac.ddr;
  const uint8_t now = board->avr->data[port] | (uint8_t)~board->avr->data[ddr];  // pulled up outside
  const uint8_t rising = now & ~board->levels_select, falling = ~now & board->levels_select;
  board->levels_select = now;
  for (int chip = 0; chip < (wiring->channels + 1) / 2; ++chip) {
    const uint8_t bit = 1 << (wiring->select_dac.shift + chip);
    if (falling & bit) board->dac_bytes = 0;
    if (rising & bit && board->dac_bytes == 2) {
      const int channel = 2 * chip + (board->dac_word >> 15);
      if (channel < CHANNELS) {
        board->dac_register[channel] = board->dac_word;
        dac_changed(board, channel);
      }
    }
  }
  if (falling & 1 << wiring->select_adc.shift) board->adc_at = board->avr->cycle < board->adc_ready ? 2 * CHANNELS : 0;
}

static int32_t dynamometer_counts(Board *board, int k) {
  if (!board->follows || board->held >> k & 1) return board->dynamometer[k];
  const int on = board_enabled(board) >> k & 1;
  if (!on && board->tendons) board->unwound[k] = board->position[k];
  const int64_t wound = board->position[k] - board->unwound[k];
  return board->dynamometer[k] + (on && (wound > 0 || !board->tendons) ? (int32_t)(wound * board->counts_per_step) : 0);
}

static double monitor_volts(Board *board, int k) {
  return board->follows && !(board->held >> (8 + k) & 1) ? board->monitor_V[k] + 4.0 * board_dac(board, k) / 4096 : board->monitor_V[k];
}

static void log_pass(Board *board, int kind) {
  Pass *pass = &board->passes[board->passes_end % PASSES_LENGTH];
  if (++board->passes_end - board->passes_begin > PASSES_LENGTH) board->passes_begin = board->passes_end - PASSES_LENGTH;
  *pass = (Pass){board->avr->cycle, board->delivered, kind, board_enabled(board), outputs_on(board), board->estop_pressed};
  for (int k = 0; k < CHANNELS; ++k) {
    pass->dynamometers[k] = board->adc_latched[k];
    pass->monitors[k] = monitor_volts(board, k) * 32768 / 5;
    pass->dac[k] = board_dac(board, k);
  }
}

static void controls_changed(Board *board) {
  const Wiring *wiring = board->wiring;
  const uint8_t convert = level(board, &wiring->convert) >> wiring->convert.shift & 1;
  if (convert && !board->levels_convert) {
    board->adc_ready = board->avr->cycle + HZ / 1000000 * 42 / 10;  // 4.2 us
    for (int k = 0; k < CHANNELS; ++k) {
      const int32_t counts = dynamometer_counts(board, k);
      board->adc_latched[k] = counts > 32767 ? 32767 : counts < -32768 ? -32768 : counts;
    }
    log_pass(board, board->avr->data[TIMSK1] & 2 ? PASS : CLOCK);  // the first edge is when its pin becomes an output
  }
  board->levels_convert = convert;
  const uint8_t outputs = outputs_on(board);
  if (outputs != board->levels_outputs) {
    board->levels_outputs = outputs;
    for (int k = 0; k < wiring->channels; ++k) dac_changed(board, k);
  }
}

// After every write of a port or its direction.
static void pins_written(avr_t *avr, avr_io_addr_t address, uint8_t value, void *parameter) {
  Board *board = parameter;
  avr->data[address] = value;
  const Wiring *wiring = board->wiring;
  if (address == wiring->dir.port || address == wiring->dir.ddr) directions_changed(board);
  if (address == wiring->step.port || address == wiring->step.ddr) steps_changed(board);
  if (address == wiring->select_dac.port || address == wiring->select_dac.ddr) selects_changed(board);
  if (address == wiring->outputs.port || address == wiring->outputs.ddr) controls_changed(board);
}

static uint8_t spi_slave(Board *board, uint8_t byte) {
  const Wiring *wiring = board->wiring;
  const uint8_t now = board->levels_select, control = board->avr->data[wiring->spcr], mode = control >> 2 & 3;
  if ((control & 0x50) != 0x50 || (board->avr->data[wiring->spi_ddr] & wiring->spi_outputs) != wiring->spi_outputs) return 0xFF;
  for (int chip = 0; chip < (wiring->channels + 1) / 2; ++chip) {
    if (now & 1 << (wiring->select_dac.shift + chip) || mode % 3) continue;  // takes mode 0 or 3
    board->dac_word = board->dac_word << 8 | byte;
    ++board->dac_bytes;
  }
  if (wiring->channels == 6 && !(now & 1 << wiring->select_adc.shift) && mode == 2) {
    const int at = board->adc_at++;
    const uint16_t word = at / 2 < CHANNELS ? (uint16_t)board->adc_latched[at / 2] : 0;
    return at & 1 ? word : word >> 8;
  }
  return 0xFF;
}

static avr_cycle_count_t spi_done(avr_t *avr, avr_cycle_count_t when, void *parameter) {
  Board *board = parameter;
  board->spi_in = spi_slave(board, board->spi_out);
  avr->data[board->wiring->spsr] |= 0x80;
  return 0;
}

static void spi_write(avr_t *avr, avr_io_addr_t address, uint8_t value, void *parameter) {
  Board *board = parameter;
  static const uint8_t DIVIDERS[] = {4, 16, 64, 128};
  const uint8_t divider = DIVIDERS[avr->data[board->wiring->spcr] & 3] >> (avr->data[board->wiring->spsr] & 1);
  board->spi_out = value;
  avr->data[board->wiring->spsr] &= ~0x80;
  avr_cycle_timer_register(avr, 8 * divider, spi_done, board);
}

static uint8_t spi_read(avr_t *avr, avr_io_addr_t address, void *parameter) {
  Board *board = parameter;
  avr->data[board->wiring->spsr] &= ~0x80;
  return board->spi_in;
}

static uint8_t adc_read(avr_t *avr, avr_io_addr_t address, void *parameter) {
  Board *board = parameter;
  const Wiring *wiring = board->wiring;
  const int input = (avr->data[wiring->admux] & 7) | (avr->data[wiring->adcsrb] & 8);
  const int dynamometer = input - wiring->first_dynamometer;
  double volts = 0;
  if (wiring->channels == 6 && input < CHANNELS) volts = monitor_volts(board, input);
  else if (dynamometer >= 0 && dynamometer < wiring->channels) volts = dynamometer_counts(board, dynamometer) * 5.0 / 32768;
  if (address == wiring->adcl) board->noise = rand_r(&board->seed) / (RAND_MAX + 1.0) - 0.5;  // +-half a count
  int value = floor(volts / 5 * 1024 + 0.5 + board->noise);
  value = value < 0 ? 0 : value > 1023 ? 1023 : value;
  return address == wiring->adcl ? value : value >> 8;
}

static uint8_t estop_read(avr_t *avr, avr_io_addr_t address, void *parameter) {
  Board *board = parameter;
  const uint16_t pin = board->wiring->estop_pin;
  const uint8_t pull_up = avr->data[pin + 2] & ~avr->data[pin + 1];  // without it an open contact may read as anything: here as closed
  return (board->estop_pressed << board->wiring->estop_bit) & pull_up;
}

// The two-wire interface as a master, and two MCP4728 on its bus.
static void twi_slave(Board *board, uint8_t byte) {
  if ((board->twi_bytes % 3) == 0) board->twi_command = byte;
  if (++board->twi_bytes % 3) {
    board->twi_word = byte;
    return;
  }
  if ((board->twi_command & 0xF8) != 0x40) return;  // takes multi-writes only
  const int output = board->twi_command >> 1 & 3, channel = output + (board->twi_address == 0x61 ? 3 : 0);
  const uint16_t word = board->twi_word << 8 | byte;
  if (output == 3 || board->twi_command & 1) return;
  board->dac_register[channel] = 0x1000 | (word & 0xF000 ? 0x0FFF : word & 0x0FFF);  // another reference, power or gain
  dac_changed(board, channel);
}

static avr_cycle_count_t twi_done(avr_t *avr, avr_cycle_count_t when, void *parameter) {
  Board *board = parameter;
  uint8_t status = board->twi_bit ? 0x10 : 0x08;
  if (board->twi_sends && board->twi_bit) {  // the address
    board->twi_address = board->twi_byte >> 1;
    board->twi_bytes = board->twi_bit = 0;
    const int chip = board->twi_address - 0x60;
    status = (chip == 0 || chip == 1) && !(board->twi_absent >> chip & 1) ? 0x18 : 0x20;
    if (status == 0x20) board->twi_address = 0;
  } else if (board->twi_sends) {
    status = board->twi_address ? 0x28 : 0x30;
    if (board->twi_address) twi_slave(board, board->twi_byte);
  } else {
    board->twi_bit = 1;
  }
  avr->data[TWSR] = (avr->data[TWSR] & 7) | status;
  avr->data[TWCR] |= 0x80;
  avr_raise_interrupt(avr, &board->twi->twi);
  return 0;
}

static void twi_write(avr_t *avr, avr_io_addr_t address, uint8_t value, void *parameter) {
  Board *board = parameter;
  avr->data[TWCR] = (value & 0x6F & ~0x08) | (value & 0x80 ? 0 : avr->data[TWCR] & 0x80);
  if (value & 0x80 || !(value & 0x04)) {
    avr_clear_interrupt(avr, &board->twi->twi);
    avr->data[TWCR] &= ~0x80;
    avr_cycle_timer_cancel(avr, twi_done, board);
  }
  if (!(value & 0x04) || (value & 0x90) == 0x90) board->twi_bit = board->twi_address = 0;
  if ((value & 0x84) != 0x84 || ((value & 0x30) == 0x10) || board->twi_hung || board->twi_stuck) return;
  board->twi_sends = !(value & 0x20);
  board->twi_byte = avr->data[TWDR];
  const uint64_t bit = 16 + 2 * avr->data[TWBR] * (1 << 2 * (avr->data[TWSR] & 3));
  avr_cycle_timer_register(avr, (board->twi_sends ? 9 : 1) * bit, twi_done, board);
}

// SDA is low as long as a chip waits to be clocked through.
static uint8_t twi_lines(avr_t *avr, avr_io_addr_t address, void *parameter) {
  const Board *board = parameter;
  return 1 | !(board->twi_hung || board->twi_stuck) << 1;
}

static void twi_clocked(avr_t *avr, avr_io_addr_t address, uint8_t value, void *parameter) {
  Board *board = parameter;
  if (avr->data[DDRD] & 1 && !(value & 1) && board->twi_stuck) --board->twi_stuck;
  avr->data[DDRD] = value;
}

// A line that is held low; bits of chips that do not answer; clocks that a chip still waits for, with SDA low.
void board_twi(Board *board, int hung, uint8_t absent, uint8_t stuck) {
  board->twi_stuck = stuck;
  board->twi_hung = hung;
  board->twi_absent = absent;
}

static void byte_received(avr_irq_t *irq, uint32_t value, void *parameter) {
  Board *board = parameter;
  log_event(&board->received, board->avr->cycle + board->uart->cycles_per_byte, 0, value & 0xFF);
}

static void core_reset(avr_t *avr) {  // whatever its cause
  Board *board = avr->custom.data;
  board->core_reset(avr);
  board->levels_convert = 0;
  board->twi_bit = board->twi_address = board->twi_bytes = 0;
  log_pass(board, RESET);
}

static void silent(avr_t *avr, const int level, const char *format, va_list arguments) {}

static void no_sleep(avr_t *avr, avr_cycle_count_t cycles) {}

Board *board_new(const char *elf, const char *mcu, uint32_t seed) {
  Board *board = calloc(1, sizeof *board);
  for (unsigned k = 0; k < sizeof WIRINGS / sizeof *WIRINGS; ++k)
    if (!strcmp(WIRINGS[k].mcu, mcu)) board->wiring = &WIRINGS[k];
  elf_firmware_t firmware = {0};
  avr_global_logger_set(silent);
  board->avr = avr_make_mcu_by_name(mcu);
  if (!board->wiring || !board->avr || elf_read_firmware(elf, &firmware)) return NULL;
  avr_t *avr = board->avr;
  avr_init(avr);
  firmware.frequency = HZ;
  firmware.vcc = firmware.avcc = firmware.aref = 5000;
  avr_load_firmware(avr, &firmware);
  avr->frequency = HZ;
  avr->sleep = no_sleep;
  board->seed = seed;
  for (int k = avr->ioend + 1; k <= avr->ramend; ++k) avr->data[k] = rand_r(&board->seed);  // memory after power-on
  avr->data[board->wiring->mcusr] |= 1;
  for (avr_io_t *io = avr->io_port; io; io = io->next)
    if (!strcmp(io->kind, "uart") && ((avr_uart_t *)io)->name == '0') board->uart = (avr_uart_t *)io;

  board->received.events = calloc(LOG_LENGTH, sizeof(Event));
  board->step_log.events = calloc(LOG_LENGTH, sizeof(Event));
  board->dir_log.events = calloc(LOG_LENGTH, sizeof(Event));
  board->dac_log.events = calloc(LOG_LENGTH, sizeof(Event));
  board->passes = calloc(PASSES_LENGTH, sizeof(Pass));
  avr->custom.data = board;
  board->core_reset = avr->reset;
  avr->reset = core_reset;
  board->line_bits_per_s = 250000;
  board->levels_select = 0xFF;
  board->stop_pc = -1;
  board->counts_per_step = 3276.8 * 1.05e-3;
  board->follows = 1;
  for (int k = 0; k < CHANNELS; ++k) board->monitor_V[k] = 1, board->dynamometer[k] = 3277;

  const Wiring *wiring = board->wiring;
  const Pins *pins[] = {&wiring->step, &wiring->dir, &wiring->ena, &wiring->select_dac, &wiring->outputs};
  for (unsigned k = 0; k < sizeof pins / sizeof *pins; ++k) {
    const uint16_t addresses[] = {pins[k]->port, pins[k]->ddr};
    for (int j = 0; j < 2; ++j) {
      avr->io[AVR_DATA_TO_IO(addresses[j])].w.c = pins_written;
      avr->io[AVR_DATA_TO_IO(addresses[j])].w.param = board;
    }
  }
  const avr_io_addr_t spdr = AVR_DATA_TO_IO(wiring->sreg_spdr), low = AVR_DATA_TO_IO(wiring->adcl), high = AVR_DATA_TO_IO(wiring->adch);
  avr->io[spdr].w.c = spi_write, avr->io[spdr].w.param = board;
  avr->io[spdr].r.c = spi_read, avr->io[spdr].r.param = board;
  avr->io[low].r.c = avr->io[high].r.c = adc_read;
  avr->io[low].r.param = avr->io[high].r.param = board;
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), byte_received, board);
  for (avr_io_t *io = avr->io_port; io; io = io->next)
    if (!strcmp(io->kind, "twi")) board->twi = (avr_twi_t *)io;
  if (wiring->channels == 6) {
    avr->io[AVR_DATA_TO_IO(PIND)].r.c = twi_lines, avr->io[AVR_DATA_TO_IO(PIND)].r.param = board;
    avr->io[AVR_DATA_TO_IO(DDRD)].w.c = twi_clocked, avr->io[AVR_DATA_TO_IO(DDRD)].w.param = board;
  }
  avr->io[AVR_DATA_TO_IO(TWCR)].w.c = twi_write, avr->io[AVR_DATA_TO_IO(TWCR)].w.param = board;
  avr->io[AVR_DATA_TO_IO(wiring->estop_pin)].r.c = estop_read;
  avr->io[AVR_DATA_TO_IO(wiring->estop_pin)].r.param = board;
  return board;
}

void board_free(Board *board) {
  avr_terminate(board->avr);
  free(board->received.events);
  free(board->step_log.events);
  free(board->dir_log.events);
  free(board->dac_log.events);
  free(board->passes);
  free(board);
}

uint64_t board_cycle(Board *board) { return board->avr->cycle; }

uint32_t board_baud(Board *board) {  // of the board's own UART
  const uint8_t *data = board->avr->data;
  const uint32_t divider = (data[board->wiring->ubrrl] | (data[board->wiring->ubrrh] & 15) << 8) + 1;
  return HZ / divider / (data[board->wiring->ucsra] & 2 ? 8 : 16);
}

// Notes signs of life (a full value written to `sign`) and how often the main loop comes round.
static void watch(Board *board, uint32_t pc) {
  const avr_t *avr = board->avr;
  const uint8_t *word = avr->flash + pc;
  const int stored = (word[1] & 0xFE) == 0x92 && (word[0] & 0x0F) == 0 && (word[2] | word[3] << 8) == board->sign;
  if (stored && avr->data[board->sign] == 8) {
    if (avr->cycle - board->last_sign > board->worst_gap) board->worst_gap = avr->cycle - board->last_sign;
    board->last_sign = avr->cycle;
  }
  if (pc != board->loop_pc) return;
  const uint64_t duration = avr->cycle - board->last_loop;
  board->last_loop = avr->cycle;
  ++board->loops;
  if (duration < 64) board->idle += duration;  // nothing to do, and no interrupt
  if (duration > board->longest_loop && board->loops > 1) board->longest_loop = duration;
}

// Whether the instruction reads what is shared, in a way that an interrupt can come between.
static int reads_shared(Board *board, uint32_t pc) {
  const avr_t *avr = board->avr;
  const uint8_t *flash = avr->flash + pc, *r = avr->data;
  const uint16_t word = flash[0] | flash[1] << 8, low = word & 0xFE0F;
  const uint16_t x = r[26] | r[27] << 8, y = r[28] | r[29] << 8, z = r[30] | r[31] << 8;
  uint16_t address = -1;
  if (low == 0x9000) address = flash[2] | flash[3] << 8;
  else if (low == 0x9001) address = z;
  else if (low == 0x9002) address = z - 1;
  else if (low == 0x9009) address = y;
  else if (low == 0x900A) address = y - 1;
  else if (low == 0x900C || low == 0x900D) address = x;
  else if (low == 0x900E) address = x - 1;
  else if ((word & 0xD200) == 0x8000) address = (word & 8 ? y : z) + ((word & 7) | (word >> 7 & 0x18) | (word >> 8 & 0x20));
  return avr->sreg[S_I] && address >= board->shared && address < board->shared + board->shared_length;
}

// Runs until that cycle, or until the program counter stands at `stop_pc` (then 1); 0, or -1 where the program crashed.
int board_run(Board *board, uint64_t until) {
  avr_t *avr = board->avr;
  avr_irq_t *input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
  while (avr->cycle < until) {
    board->uart->cycles_per_byte = 10 * HZ / board_baud(board);
    uint64_t stop = until;
    if (board->sent_begin != board->sent_end) {
      if (board->next_byte <= avr->cycle) {
        avr_raise_irq(input, board->sent[board->sent_begin++ % SENT_LENGTH]);
        board->next_byte += 10 * HZ / board->line_bits_per_s;
        ++board->delivered;
        continue;
      }
      if (board->next_byte < stop) stop = board->next_byte;
    }
    while (avr->cycle < stop) {
      if (board->slow && avr->cycle >= board->next_slow) {
        avr->cycle += board->slow;
        board->next_slow = avr->cycle + SLOW_EVERY - board->slow;
      }
      const uint32_t pc = avr->pc;
      if (board->shared_length) board->unguarded += reads_shared(board, pc);
      const int state = avr_run(avr);
      if (board->sign) watch(board, pc);
      if (avr->pc == board->stop_pc) return 1;
      if (state == cpu_Crashed || state == cpu_Done || state == cpu_Stopped) return -1;
    }
  }
  return 0;
}

// Bytes follow each other on the line at its speed; returns how many found room.
uint32_t board_send(Board *board, const uint8_t *bytes, uint32_t count) {
  if (board->sent_begin == board->sent_end && board->next_byte < board->avr->cycle)
    board->next_byte = board->avr->cycle + 10 * HZ / board->line_bits_per_s;
  for (uint32_t k = 0; k < count; ++k) {
    if (board->sent_end - board->sent_begin >= SENT_LENGTH) return k;
    board->sent[board->sent_end++ % SENT_LENGTH] = bytes[k];
  }
  return count;
}

void board_cut(Board *board) { board->sent_begin = board->sent_end; }  // what is still on the line is lost

void board_line(Board *board, uint32_t bits_per_s) { board->line_bits_per_s = bits_per_s; }

// Bytes that have arrived by now.
uint32_t board_take(Board *board, uint8_t *bytes, uint32_t most) {
  uint32_t count = 0;
  Log *log = &board->received;
  while (count < most && log->begin != log->end && log->events[log->begin % LOG_LENGTH].cycle <= board->avr->cycle)
    bytes[count++] = log->events[log->begin++ % LOG_LENGTH].value;
  return count;
}

static uint32_t take_events(Log *log, Event *events, uint32_t most) {
  uint32_t count = 0;
  while (count < most && log->begin != log->end) events[count++] = log->events[log->begin++ % LOG_LENGTH];
  return count;
}

uint32_t board_take_steps(Board *board, Event *events, uint32_t most) { return take_events(&board->step_log, events, most); }

uint32_t board_take_directions(Board *board, Event *events, uint32_t most) { return take_events(&board->dir_log, events, most); }

uint32_t board_take_dac(Board *board, Event *events, uint32_t most) { return take_events(&board->dac_log, events, most); }

uint32_t board_take_passes(Board *board, Pass *passes, uint32_t most) {
  uint32_t count = 0;
  while (count < most && board->passes_begin != board->passes_end) passes[count++] = board->passes[board->passes_begin++ % PASSES_LENGTH];
  return count;
}

uint32_t board_delivered(Board *board) { return board->delivered; }

void board_peaks(Board *board, uint16_t *codes) { memcpy(codes, board->dac_peak, sizeof board->dac_peak); }

int64_t board_position(Board *board, int channel) { return board->position[channel]; }

uint64_t board_steps(Board *board, int channel) { return board->steps[channel]; }

uint64_t board_idle_steps(Board *board) { return board->idle_steps; }

int board_outputs(Board *board) { return outputs_on(board); }

void board_follow(Board *board, int follows) { board->follows = follows; }

void board_tendons(Board *board, int tendons) { board->tendons = tendons; }

void board_hold(Board *board, uint16_t bits) { board->held = bits; }

void board_monitor(Board *board, int channel, double volts) { board->monitor_V[channel] = volts; }

void board_dynamometer(Board *board, int channel, int32_t counts) { board->dynamometer[channel] = counts; }

void board_counts_per_step(Board *board, double counts) { board->counts_per_step = counts; }

void board_estop(Board *board, int pressed) { board->estop_pressed = pressed; }

// A reset with a bit of MCUSR: 1 power-on (memory is lost), 2 pin, 4 brown-out.
void board_reset(Board *board, uint8_t cause) {
  avr_t *avr = board->avr;
  const uint8_t flags = cause == 1 ? 0 : avr->data[board->wiring->mcusr];  // stay until the program clears them
  avr_reset(avr);
  avr->data[board->wiring->mcusr] |= cause | flags;
  if (cause == 1) {
    for (int k = avr->ioend + 1; k <= avr->ramend; ++k) avr->data[k] = rand_r(&board->seed);
    for (int k = 0; k < CHANNELS; ++k) board->dac_register[k] = board->dac_memory;
  }
  directions_changed(board);
  steps_changed(board);
  selects_changed(board);
  controls_changed(board);
}

// Writes a word of the program; returns what was there.
uint16_t board_patch(Board *board, uint32_t address, uint16_t word) {
  uint8_t *flash = board->avr->flash + address;
  const uint16_t before = flash[0] | flash[1] << 8;
  flash[0] = word, flash[1] = word >> 8;
  return before;
}

void board_slow(Board *board, double share) { board->slow = share * SLOW_EVERY; }

uint32_t board_pc(Board *board) { return board->avr->pc; }

void board_stop_at(Board *board, uint32_t pc) { board->stop_pc = pc; }

void board_dac_memory(Board *board, uint16_t code) {
  board->dac_memory = 0x1000 | code;
  for (int k = 0; k < CHANNELS; ++k) board->dac_register[k] = board->dac_memory;
}

// Begins to watch.
void board_watch(Board *board, uint16_t sign, uint32_t loop) {
  board->sign = sign, board->loop_pc = loop;
  board->last_sign = board->last_loop = board->avr->cycle;
  board->worst_gap = board->loops = board->longest_loop = board->idle = 0;
}

// Begins to count how often what is shared with an interrupt is read with interrupts on.
void board_share(Board *board, uint16_t address, uint16_t length) {
  board->shared = address, board->shared_length = length;
  board->unguarded = 0;
}

uint64_t board_unguarded(Board *board) { return board->unguarded; }

uint64_t board_worst_gap(Board *board) { return board->worst_gap; }

uint64_t board_longest_loop(Board *board) { return board->longest_loop; }

uint64_t board_idle_cycles(Board *board) { return board->idle; }

uint8_t board_byte(Board *board, uint16_t address) { return board->avr->data[address]; }

void board_write(Board *board, uint16_t address, uint8_t byte) { board->avr->data[address] = byte; }

#ifdef PROGRAM
#include <errno.h>
#include <pty.h>
#include <signal.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

static volatile sig_atomic_t done;

static void stop(int signal) { done = 1; }

static double now(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return time.tv_sec + 1e-9 * time.tv_nsec;
}

// emulator FIRMWARE.elf [LINK]: prints the terminal to open; opening it resets the board, as on the real one.
int main(int count, char **arguments) {
  if (count < 2) return fprintf(stderr, "usage: %s FIRMWARE.elf [LINK]\n", arguments[0]), 2;
  Board *board = board_new(arguments[1], "atmega2560", 1);
  if (!board) return fprintf(stderr, "%s: no firmware for an ATmega2560\n", arguments[1]), 2;
  int master, slave;
  char name[256];
  struct termios raw;
  if (openpty(&master, &slave, name, NULL, NULL)) return perror("openpty"), 1;
  tcgetattr(slave, &raw);
  cfmakeraw(&raw);
  tcsetattr(slave, TCSANOW, &raw);
  close(slave);
  fcntl(master, F_SETFL, O_NONBLOCK);
  if (count > 2) {
    unlink(arguments[2]);
    if (symlink(name, arguments[2])) return perror(arguments[2]), 1;
  }
  signal(SIGTERM, stop);
  signal(SIGINT, stop);
  printf("%s\n", name);
  fflush(stdout);
  int open_before = 0;
  double begin = now();
  uint64_t cycle = board_cycle(board);
  while (!done) {
    struct pollfd state = {master, POLLIN, 0};
    poll(&state, 1, 0);
    const int open_now = !(state.revents & POLLHUP);
    if (open_now && !open_before) board_reset(board, 2);
    open_before = open_now;
    uint8_t bytes[4096];
    const ssize_t got = open_now ? read(master, bytes, sizeof bytes) : 0;
    if (got > 0) board_send(board, bytes, got);
    cycle += HZ / 1000;
    if (board_run(board, cycle)) return fprintf(stderr, "the firmware crashed\n"), 1;
    const uint32_t came = board_take(board, bytes, sizeof bytes);
    if (open_now && came && write(master, bytes, came) < 0 && errno != EAGAIN) perror("write");
    const double ahead = begin + (double)cycle / HZ - now();
    if (ahead > 0) usleep(1e6 * ahead);
    else if (ahead < -0.5) begin -= ahead;  // the machine was busy: do not race afterwards
  }
  if (count > 2) unlink(arguments[2]);
  for (int k = 0; k < CHANNELS; ++k) fprintf(stderr, "%u %lld ", board_dac(board, k), (long long)board_position(board, k));
  fprintf(stderr, "enabled %u\n", board_enabled(board));
  return 0;
}
#endif
