#include "servos.h"

#include <util/atomic.h>

namespace rtagent {

namespace {

const uint16_t TicksPerUs = F_CPU / 8 / 1000000;
const uint16_t FrameTicks = 20000 * TicksPerUs;
const uint8_t Soon = 8;  // ticks: the least that a comparison can be set ahead

struct Pin {
  volatile uint8_t *port;
  uint8_t mask;
  volatile uint16_t ticks;  // 0: no pulse
};

Pin pins[Servos::Most];
uint8_t pin_count = 0;
uint8_t current = 0;  // whose pulse it is; pin_count: the pause before the next frame
uint16_t frame_began = 0;

// Begins the next pulse of this frame, or the pause after the last.
inline void next_pulse(uint16_t now) {
  while (++current < pin_count) {
    Pin &pin = pins[current];
    if (pin.ticks) {
      *pin.port |= pin.mask;
      OCR1A = now + pin.ticks;
      return;
    }
  }
  uint16_t pause = frame_began + FrameTicks - now;
  OCR1A = now + (pause > Soon && pause <= FrameTicks ? pause : Soon);
}

}  // namespace

}  // namespace rtagent

ISR(TIMER1_COMPA_vect) {
  using namespace rtagent;
  uint16_t now = OCR1A;  // when this was due, so that lateness does not add up
  if (current < pin_count) {
    *pins[current].port &= ~pins[current].mask;
  } else {
    frame_began = now;
    current = -1;
  }
  next_pulse(now);
}

namespace rtagent {

void Servos::begin(const uint8_t *numbers, uint8_t count) {
  count_ = pin_count = current = count < Most ? count : Most;
  for (uint8_t i = 0; i < count_; i++) {
    pinMode(numbers[i], OUTPUT);
    pins[i].port = portOutputRegister(digitalPinToPort(numbers[i]));
    pins[i].mask = digitalPinToBitMask(numbers[i]);
    pins[i].ticks = 0;
  }
  if (!count_) return;
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    TCCR1A = 0;
    TCCR1B = _BV(CS11);  // an eighth of the processor's clock
    OCR1A = TCNT1 + FrameTicks;
    TIFR1 = _BV(OCF1A);
    TIMSK1 = _BV(OCIE1A);
  }
}

void Servos::pulse(uint8_t servo, uint16_t width) {
  if (servo >= count_) return;
  uint16_t ticks = width ? constrain(width, Shortest, Longest) * TicksPerUs : 0;
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { pins[servo].ticks = ticks; }
}

uint16_t Servos::width(uint8_t servo) const {
  uint16_t ticks = 0;
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { ticks = pins[servo].ticks; }
  return ticks / TicksPerUs;
}

bool Servos::any() const {
  for (uint8_t i = 0; i < count_; i++) {
    if (width(i)) return true;
  }
  return false;
}

void Servos::detach() {
  for (uint8_t i = 0; i < count_; i++) pulse(i, 0);
}

}  // namespace rtagent
