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

Frame::Frame(uint8_t type) { put8(type); }

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

void Frame::close() {
  const uint16_t check = crc(bytes_, size_);
  bytes_[size_++] = check;
  bytes_[size_++] = check >> 8;
  uint8_t mark = 0;
  end_ = 1;
  for (uint8_t i = 0; i < size_; i++) {  // shorter than the 254 bytes after which COBS needs another mark
    if (bytes_[i]) {
      stuffed_[end_++] = bytes_[i];
    } else {
      stuffed_[mark] = end_ - mark;
      mark = end_++;
    }
  }
  stuffed_[mark] = end_ - mark;
  stuffed_[end_++] = 0;
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
