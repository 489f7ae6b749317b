// Runs a sketch without a board: its serial port is a pseudo-terminal, its inputs come from the standard input.
//
//   simulator --mcu atmega2560 --link ./hand [--watch E5]... hand-mega.elf
//
// It prints "ready" once programs can open the link. Orders, one a line: `adc 3 512` (channel, reading), `pin D2 0`,
// `reset`, `time`. It answers each with a JSON object that holds the board's time (ns), and prints one whenever the
// pulses on a watched pin change: {"time": 1000000, "pin": "E5", "pulse": 1500.0}; a pulse of 0 (µs) means none.
// It keeps to real time, as far as it is quick enough; it ends with its standard input, or by a signal.

#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <avr_adc.h>
#include <avr_ioport.h>
#include <avr_uart.h>
#include <sim_avr.h>
#include <sim_elf.h>

enum { CLOCK = 16000000, SLICE = 4000, VCC = 5000, CHANNELS = 16, MOST_WATCHED = 8, LINE = 80 };
#define NO_PULSE_FOR ((avr_cycle_count_t)CLOCK / 30)  // two servo frames with room to spare, in cycles

typedef struct {
  char name[4];
  avr_cycle_count_t rose;
  double pulse;  // µs, as last told
} Watched;

static avr_t *avr;
static avr_adc_t *adc;
static avr_irq_t *adc_inputs, *uart_input;
static unsigned readings[CHANNELS];
static Watched watched[MOST_WATCHED];
static int watched_count;
static bool line_full;
static uint8_t to_board[4096], to_host[4096];
static size_t to_board_size, to_host_size;
static const char *link_name;
static int terminal = -1;

static void fail(const char *why) {
  fprintf(stderr, "simulator: %s%s%s\n", why, errno ? ": " : "", errno ? strerror(errno) : "");
  exit(2);
}

static double board_time(void) { return avr->cycle * (1e9 / CLOCK); }

static void tell(const char *format, ...) {
  printf("{\"time\": %.0f", board_time());
  va_list arguments;
  va_start(arguments, format);
  vprintf(format, arguments);
  va_end(arguments);
  puts("}");
}

// The converter. simavr keeps eight readings only: channels from 8 on share the place of the one 8 below, which
// gets its reading when a conversion begins.

static unsigned chosen_channel(void) {
  unsigned mux = avr_regbit_get_array(avr, adc->mux, ARRAY_SIZE(adc->mux));
  return (mux & 7) | (mux & 0x20 ? 8 : 0);
}

static void begin_conversion(avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq, (void)value, (void)param;
  unsigned channel = chosen_channel();
  unsigned millivolts = (readings[channel] * VCC + 1022) / 1023;
  avr_raise_irq(adc_inputs + ADC_IRQ_ADC0 + (channel & 7), millivolts);
}

static void set_up_adc(void) {
  for (avr_io_t *io = avr->io_port; io; io = io->next) {
    if (!strcmp(io->kind, "adc")) adc = (avr_adc_t *)io;
  }
  if (!adc) fail("this processor has no converter");
  for (size_t i = 0; i < ARRAY_SIZE(adc->muxmode); i++) {
    if (adc->muxmode[i].kind == ADC_MUX_SINGLE) adc->muxmode[i].src &= 7;
  }
  adc_inputs = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, 0);
  avr_irq_register_notify(adc_inputs + ADC_IRQ_OUT_TRIGGER, begin_conversion, NULL);
  avr->vcc = avr->avcc = avr->aref = VCC;
}

// The serial port.

static void hear_byte(avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq, (void)param;
  if (to_host_size < sizeof to_host) to_host[to_host_size++] = value;
}

static void stop_sending(avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq, (void)param;
  if (value) line_full = true;
}

static void go_on_sending(avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq, (void)param;
  if (value) line_full = false;
}

static void set_up_uart(void) {
  uint32_t flags = 0;  // print nothing, never sleep
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  avr_irq_t *uart = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), 0);
  uart_input = uart + UART_IRQ_INPUT;
  avr_irq_register_notify(uart + UART_IRQ_OUTPUT, hear_byte, NULL);
  avr_irq_register_notify(uart + UART_IRQ_OUT_XOFF, stop_sending, NULL);
  avr_irq_register_notify(uart + UART_IRQ_OUT_XON, go_on_sending, NULL);
}

static void send_to_board(void) {
  size_t sent = 0;
  while (sent < to_board_size && !line_full) avr_raise_irq(uart_input, to_board[sent++]);
  memmove(to_board, to_board + sent, to_board_size -= sent);
}

static void exchange_bytes(void) {
  if (to_host_size) {
    if (write(terminal, to_host, to_host_size) < 0 && errno != EAGAIN && errno != EIO) fail("cannot write");
    to_host_size = 0;  // what nobody fetches is lost, as on a line
  }
  ssize_t got = read(terminal, to_board + to_board_size, sizeof to_board - to_board_size);
  if (got > 0) to_board_size += got;
  send_to_board();
}

// Pins.

static avr_irq_t *pin_irq(const char *name) {
  if (strlen(name) != 2 || name[1] < '0' || name[1] > '7') return NULL;
  return avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(name[0]), name[1] - '0');
}

static void see_edge(avr_irq_t *irq, uint32_t level, void *param) {
  (void)irq;
  Watched *pin = param;
  if (level) {
    pin->rose = avr->cycle;
  } else if (pin->rose) {
    double pulse = (avr->cycle - pin->rose) * (1e6 / CLOCK);
    if (pulse > pin->pulse + 8 || pulse < pin->pulse - 8) {  // interrupts move an edge by some µs
      tell(", \"pin\": \"%s\", \"pulse\": %.1f", pin->name, pin->pulse = pulse);
    }
  }
}

static void see_silence(void) {
  for (Watched *pin = watched; pin < watched + watched_count; pin++) {
    if (pin->pulse && avr->cycle - pin->rose > NO_PULSE_FOR) {
      tell(", \"pin\": \"%s\", \"pulse\": 0", pin->name);
      pin->pulse = 0;
    }
  }
}

static void watch(const char *name) {
  avr_irq_t *irq = pin_irq(name);
  if (!irq || watched_count == MOST_WATCHED) fail("cannot watch that pin");
  strcpy(watched[watched_count].name, name);
  avr_irq_register_notify(irq, see_edge, &watched[watched_count++]);
}

// Orders.

static void obey(const char *order) {
  unsigned channel, reading, level;
  char name[4];
  if (sscanf(order, "adc %u %u", &channel, &reading) == 2 && channel < CHANNELS && reading < 1024) {
    readings[channel] = reading;
  } else if (sscanf(order, "pin %3s %u", name, &level) == 2 && pin_irq(name)) {
    avr_raise_irq(pin_irq(name), level != 0);
  } else if (!strcmp(order, "reset")) {
    avr_reset(avr);
    to_board_size = 0;
    line_full = false;
  } else if (strcmp(order, "time")) {
    fprintf(stderr, "simulator: no such order: %s\n", order);
    return;
  }
  tell(", \"obeyed\": \"%s\"", order);
}

static bool take_orders(void) {
  static char line[LINE];
  static size_t filled;
  char byte;
  ssize_t got;
  while ((got = read(STDIN_FILENO, &byte, 1)) == 1) {
    if (byte == '\n') {
      line[filled] = 0;
      filled = 0;
      obey(line);
    } else if (filled < LINE - 1) {
      line[filled++] = byte;
    }
  }
  return got != 0;
}

// The terminal, and life.

static void unplug(void) {
  char target[64];
  ssize_t size = readlink(link_name, target, sizeof target - 1);
  if (size > 0 && (target[size] = 0, !strcmp(target, ptsname(terminal)))) unlink(link_name);
}

static void end(int number) {
  (void)number;
  unplug();
  _exit(0);
}

static void plug(void) {
  terminal = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  if (terminal < 0 || grantpt(terminal) || unlockpt(terminal)) fail("no pseudo-terminal");
  int far = open(ptsname(terminal), O_RDWR | O_NOCTTY);  // stays open, so that the line is there without a program
  struct termios settings;
  tcgetattr(far, &settings);
  cfmakeraw(&settings);
  tcsetattr(far, TCSANOW, &settings);
  unlink(link_name);
  if (symlink(ptsname(terminal), link_name)) fail("cannot make the link");
  atexit(unplug);
  signal(SIGTERM, end);
  signal(SIGINT, end);
  signal(SIGHUP, end);
}

static int64_t now(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return time.tv_sec * 1000000000LL + time.tv_nsec;
}

// Sleeps while the board is ahead of the clock. What it is behind by more than some ms is not made up for.
static void keep_time(void) {
  static int64_t began;
  int64_t ahead = began + (int64_t)board_time() - now();
  if (ahead < -5000000) {
    began -= ahead;
  } else if (ahead > 100000) {
    struct pollfd files[] = {{STDIN_FILENO, POLLIN, 0}, {terminal, POLLIN, 0}};
    struct timespec most = {0, ahead};
    ppoll(files, 2, &most, NULL);
  }
}

static void run(void) {
  do {
    avr_cycle_count_t until = avr->cycle + SLICE;
    while (avr->cycle < until) {
      int state = avr_run(avr);
      if (state == cpu_Done || state == cpu_Crashed) fail("the sketch has crashed");
    }
    see_silence();
    exchange_bytes();
    keep_time();
  } while (take_orders());
}

static void quiet(avr_t *board, const int level, const char *format, va_list arguments) {
  (void)board;
  if (level <= LOG_ERROR) vfprintf(stderr, format, arguments);
}

int main(int count, char *arguments[]) {
  const char *mcu = "atmega328p", *firmware = NULL, *pins[MOST_WATCHED];
  int pin_count = 0;
  for (int i = 1; i < count; i++) {
    bool has_value = i + 1 < count;
    if (!strcmp(arguments[i], "--mcu") && has_value) mcu = arguments[++i];
    else if (!strcmp(arguments[i], "--link") && has_value) link_name = arguments[++i];
    else if (!strcmp(arguments[i], "--watch") && has_value && pin_count < MOST_WATCHED) pins[pin_count++] = arguments[++i];
    else firmware = arguments[i];
  }
  if (!link_name || !firmware) fail("usage: simulator --mcu MCU --link LINK [--watch PIN]... FIRMWARE");
  elf_firmware_t elf = {0};
  avr_global_logger_set(quiet);
  if (elf_read_firmware(firmware, &elf)) fail("cannot read the firmware");
  if (!(avr = avr_make_mcu_by_name(mcu)) || avr_init(avr)) fail("no such processor");
  avr->frequency = CLOCK;
  avr_load_firmware(avr, &elf);
  avr->frequency = CLOCK;
  set_up_adc();
  set_up_uart();
  for (int i = 0; i < pin_count; i++) watch(pins[i]);
  fcntl(STDIN_FILENO, F_SETFL, fcntl(STDIN_FILENO, F_GETFL) | O_NONBLOCK);
  setvbuf(stdout, NULL, _IOLBF, 0);
  errno = 0;
  plug();
  puts("ready");
  run();
  return 0;
}
