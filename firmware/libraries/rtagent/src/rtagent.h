// A board that measures channels at a steady rate, moves servos, and makes them safe when nobody speaks to it.
// Servos that were made safe move only after they were armed again.
#pragma once

#include "frames.h"
#include "servos.h"

namespace rtagent {

const uint8_t MostChannels = 16;

enum Stop : uint8_t { Detach = 0, Hold = 1 };
enum Safety : uint8_t { Moving = 0, ToldTo = 1, Unheard = 2 };

struct Settings {
  uint32_t period = 10000;   // µs from one scan to the next
  uint16_t heartbeat = 200;  // ms of silence after which the servos are made safe
  uint8_t stop = Detach;     // what that means
};

class Board {
 public:
  // `channels` and `servos` are pins, such as A0 or 2; digital channels have a pull-up resistor.
  template <uint8_t Channels>
  explicit Board(const uint8_t (&channels)[Channels]) : channels_(channels), count_(Channels) {
    static_assert(Channels <= MostChannels, "too many channels");
  }
  template <uint8_t Channels, uint8_t ServoCount>
  Board(const uint8_t (&channels)[Channels], const uint8_t (&servos)[ServoCount])
      : channels_(channels), servo_pins_(servos), count_(Channels), servo_count_(ServoCount) {
    static_assert(Channels <= MostChannels, "too many channels");
    static_assert(ServoCount <= Servos::Most, "too many servos");
  }

  // Native USB takes any rate.
  template <uint32_t Baud>
  void begin() {
    static_assert(F_CPU / 8 % Baud == 0, "this board has no such rate exactly: take 250000, 500000, 1000000 or 2000000");
    Serial.begin(Baud);
    start();
  }

  // To be called again and again.
  void turn();

 private:
  void start();
  void configure(const Settings &settings);
  void choose_adc_clock();
  void hear();
  void obey(const Receiver &told);
  void move(const Receiver &told);
  void make_safe(Safety why);
  void watch_heartbeat();
  uint32_t measure_all(Frame &frame) const;
  void scan();
  uint16_t measure(uint8_t channel) const;
  void say_hello(bool started);
  void say_state();

  const uint8_t *channels_;
  const uint8_t *servo_pins_ = nullptr;
  uint8_t count_, servo_count_ = 0;
  Settings settings_;
  Servos servos_;
  Receiver receiver_;
  uint8_t safety_ = ToldTo;
  uint16_t number_ = 0;
  uint32_t due_ = 0, heard_ = 0;
};

}  // namespace rtagent
