"""A serial line without pyserial: blocking files, few imports, for processes that have to be there at once."""

from __future__ import annotations

import array
import fcntl
import os
import termios

TCGETS2, TCSETS2, CBAUD, BOTHER = 0x802C542A, 0x402C542B, 0o010017, 0o010000
"""How Linux sets a rate that is no constant (asm-generic/ioctls.h, termbits.h)."""

CONTROL_FLAGS, INPUT_SPEED, OUTPUT_SPEED = 2, 9, 10


def open_line(port: str, baud: int) -> int:
    """Return a file of `port`, beside those that others may have of it; raises OSError or termios.error."""
    fd = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        set_raw(fd, baud)
    except BaseException:
        os.close(fd)
        raise
    return fd


def read_some(fd: int) -> bytes:
    """Return what has come, which may be nothing; raise OSError where the line has gone."""
    try:
        data = os.read(fd, 4096)
    except BlockingIOError:
        return b""
    if not data:
        raise OSError("it was unplugged")
    return data


def set_raw(fd: int, baud: int) -> None:
    """Let bytes through as they are, at `baud` bits a second."""
    settings = termios.tcgetattr(fd)
    settings[0] = settings[1] = settings[3] = 0
    settings[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
    constant = getattr(termios, f"B{baud}", None)
    settings[4] = settings[5] = termios.B38400 if constant is None else constant
    settings[6][termios.VMIN], settings[6][termios.VTIME] = 1, 0
    termios.tcsetattr(fd, termios.TCSANOW, settings)
    if constant is None:
        numbers = array.array("i", [0] * 64)
        fcntl.ioctl(fd, TCGETS2, numbers)
        numbers[CONTROL_FLAGS] = numbers[CONTROL_FLAGS] & ~CBAUD | BOTHER
        numbers[INPUT_SPEED] = numbers[OUTPUT_SPEED] = baud
        fcntl.ioctl(fd, TCSETS2, numbers)
