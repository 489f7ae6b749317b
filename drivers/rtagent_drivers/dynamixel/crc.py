"""The CRC-16 of protocol 2.0: polynomial 0x8005, from 0, nothing reflected."""

from __future__ import annotations

POLYNOMIAL = 0x8005


def _entry(byte: int) -> int:
    crc = byte << 8
    for _ in range(8):
        crc = (crc << 1) ^ (POLYNOMIAL if crc & 0x8000 else 0)
        crc &= 0xFFFF
    return crc


# bytes of bytes: small, and what they give needs no new object
_HIGH = bytes(_entry(byte) >> 8 for byte in range(256))
_LOW = bytes(_entry(byte) & 0xFF for byte in range(256))


def crc16(data: bytes, crc: int = 0) -> int:
    """Return the CRC of `data`, going on from that of what came before."""
    high, low = crc >> 8, crc & 0xFF
    highs, lows = _HIGH, _LOW
    for byte in data:
        index = high ^ byte
        high = low ^ highs[index]
        low = lows[index]
    return high << 8 | low
