#include "frames.h"

#include <util/crc16.h>

namespace rtagent {

namespace {

uint16_t crc(const uint8_t *bytes, uint8_t size) {
  uint16_t crc = 0xFFFF;
  for (uint8_t i = 0; i < size; i++) crc = _crc_xmodem_update(crc, bytes[i]);
  return crc;
}

}  // namespace

Frame::Frame(uint8_t type) : size_(0) { put8(type); }

void Frame::put8(uint8_t value) {
  if (size_ < Most - 2) bytes_[size_++] = value;  // two are left for the CRC
}

void Frame::put16(uint16_t value) {
  put8(value);
  put8(value >> 8);
}

void Frame::put32(uint32_t value) {
  put16(value);
  put16(value >> 16);
}

uint8_t Frame::send(Stream &line) {
  uint16_t check = crc(bytes_, size_);
  bytes_[size_++] = check;
  bytes_[size_++] = check >> 8;
  uint8_t stuffed[Most + 2];
  uint8_t mark = 0, end = 1;  // frames are shorter than the 254 bytes after which COBS needs another mark
  for (uint8_t i = 0; i < size_; i++) {
    if (bytes_[i]) {
      stuffed[end++] = bytes_[i];
    } else {
      stuffed[mark] = end - mark;
      mark = end++;
    }
  }
  stuffed[mark] = end - mark;
  stuffed[end++] = 0;
  return line.write(stuffed, end);
}

bool Receiver::take(uint8_t byte) {
  if (byte) {
    if (filled_ == Most) {
      too_long_ = true;
    } else {
      bytes_[filled_++] = byte;
    }
    return false;
  }
  bool empty = filled_ == 0;
  bool good = !too_long_ && !empty && unstuff();
  if (!good && !empty) bad_++;
  filled_ = 0;
  too_long_ = false;
  return good;
}

bool Receiver::unstuff() {
  uint8_t next = 0, size = 0;
  for (uint8_t i = 0; i < filled_; i++) {
    if (i != next) {
      bytes_[size++] = bytes_[i];
      continue;
    }
    if (i) bytes_[size++] = 0;
    next = i + bytes_[i];
  }
  if (next != filled_ || size < 3) return false;
  size_ = size - 3;
  return crc(bytes_, size - 2) == (bytes_[size - 2] | uint16_t(bytes_[size - 1]) << 8);
}

}  // namespace rtagent
