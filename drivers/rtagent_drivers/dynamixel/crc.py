"""The CRC-16 of protocol 2.0: polynomial 0x8005, from 0, nothing reflected."""

from __future__ import annotations

POLYNOMIAL = 0x8005


def _entry(byte: int) -> int:
    crc = byte << 8
    for _ in range(8):
        crc = (crc << 1) ^ (POLYNOMIAL if crc & 0x8000 else 0)
        crc &= 0xFFFF
    return crc


_TABLE = tuple(map(_entry, range(256)))


def crc16(data: bytes, crc: int = 0) -> int:
    """Return the CRC of `data`, going on from that of what came before."""
    table = _TABLE
    for byte in data:
        crc = (crc & 0xFF) << 8 ^ table[crc >> 8 ^ byte]
    return crc
