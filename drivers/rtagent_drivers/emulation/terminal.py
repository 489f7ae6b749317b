"""A pseudo-terminal under a name of our choice, as a servo bus on a USB adapter looks to programs."""

from __future__ import annotations

import array
import contextlib
import errno
import fcntl
import os
import tty
from pathlib import Path

from rtagent.errors import SpecError

TCGETS2 = 0x802C542A
"""Asks a Linux terminal for its settings with the baud rates as numbers (asm-generic/ioctls.h, termbits.h)."""

TERMIOS2_WORDS, OUTPUT_SPEED = 11, 10


class Terminal:
    """A pty whose near end is ours; `link` names its far end, from `plug` to `unplug`."""

    def __init__(self, link: Path) -> None:
        self._link = link
        self._near = self._far = -1
        if link.exists() and not link.is_symlink():
            raise SpecError(f"{link} is there already, and is no link: give another name.")
        if not link.parent.is_dir():
            raise SpecError(f"there is no folder {link.parent}: make it, or give another name.")

    @property
    def fileno(self) -> int:
        """The file to wait for and to read from; -1 while it is unplugged."""
        return self._near

    def plug(self) -> None:
        """Make the pty and its link."""
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        os.set_blocking(self._near, False)
        beside = self._link.with_name(f".{self._link.name}.{os.getpid()}")
        beside.symlink_to(os.ttyname(self._far))
        beside.replace(self._link)

    def unplug(self) -> None:
        """Take it away: whoever has it open finds it hung up."""
        if self._near < 0:
            return
        if self._is_ours():
            self._link.unlink()
        os.close(self._near)
        os.close(self._far)
        self._near = self._far = -1

    def read(self) -> bytes:
        """Return what a program has written; nothing where there is nothing."""
        with contextlib.suppress(BlockingIOError):
            return os.read(self._near, 4096)
        return b""

    def write(self, data: bytes) -> None:
        """Hand over bytes; those that nobody fetches are lost, as on a line."""
        try:
            os.write(self._near, data)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise

    def baud(self) -> int:
        """Return the bit/s that the program has set."""
        settings = array.array("I", bytes(4 * TERMIOS2_WORDS))
        fcntl.ioctl(self._far, TCGETS2, settings)
        return settings[OUTPUT_SPEED]

    def _is_ours(self) -> bool:
        with contextlib.suppress(OSError):
            return self._link.readlink() == Path(os.ttyname(self._far))
        return False
