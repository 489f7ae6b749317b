// Servo pulses by timer 1: one servo after the other, each once in 20 ms.
#pragma once

#include <Arduino.h>

namespace rtagent {

class Servos {
 public:
  static const uint8_t Most = 8;
  static const uint16_t Shortest = 500, Longest = 2400;  // µs; eight of the longest fit into 20 ms
  static const uint16_t Unchanged = 0xFFFF;

  // `pins` must stay where they are.
  void begin(const uint8_t *pins, uint8_t count);
  uint8_t count() const { return count_; }
  // Gives a servo pulses of so many µs; 0: none, so that it goes limp.
  void pulse(uint8_t servo, uint16_t width);
  uint16_t width(uint8_t servo) const;
  bool any() const;
  void detach();

 private:
  uint8_t count_ = 0;
};

}  // namespace rtagent
