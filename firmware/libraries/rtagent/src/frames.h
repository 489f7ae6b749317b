// Frames: a type, a body and a CRC-16, stuffed by COBS so that a zero ends each of them and stands nowhere else.
#pragma once

#include <Arduino.h>

namespace rtagent {

const uint8_t Version = 1;

// What a board says.
const uint8_t Hello = 'H', Scan = 'S', ServoState = 'V';
// What it is told.
const uint8_t Ask = 'h', Configure = 'c', Arm = 'a', Pulses = 'v', MakeSafe = 's';

// A frame to be sent. Numbers are little endian.
class Frame {
 public:
  explicit Frame(uint8_t type);
  void put8(uint8_t value);
  void put16(uint16_t value);
  void put32(uint32_t value);
  // Makes it ready to be sent; nothing can be put into it any more.
  void close();
  void send(Stream &line) const { line.write(stuffed_, end_); }

 private:
  static const uint8_t Most = 120;
  uint8_t bytes_[Most], stuffed_[Most + 2];
  uint8_t size_ = 0, end_ = 0;
};

// Makes frames of the bytes that come.
class Receiver {
 public:
  // Takes a byte; returns whether a good frame is complete.
  bool take(uint8_t byte);
  uint8_t type() const { return bytes_[0]; }
  // How many bytes its body has.
  uint8_t size() const { return size_; }
  uint8_t get8(uint8_t at) const { return bytes_[1 + at]; }
  uint16_t get16(uint8_t at) const { return get8(at) | uint16_t(get8(at + 1)) << 8; }
  uint32_t get32(uint8_t at) const { return get16(at) | uint32_t(get16(at + 2)) << 16; }
  // How many frames were damaged so far.
  uint16_t bad() const { return bad_; }

 private:
  bool unstuff();

  static const uint8_t Most = 64;
  uint8_t bytes_[Most];
  uint8_t filled_ = 0, size_ = 0;
  bool too_long_ = false;
  uint16_t bad_ = 0;
};

}  // namespace rtagent
