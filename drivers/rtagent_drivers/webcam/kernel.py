"""What a camera asks of the kernel, so that another can take its place."""

from __future__ import annotations

import ctypes
import fcntl
import mmap
import os
from typing import Protocol


class Memory(Protocol):
    """A buffer of the kernel's, mapped into this process."""

    def __getitem__(self, part: slice, /) -> bytes:
        """Return a copy of some bytes."""

    def __buffer__(self, flags: int, /) -> memoryview:
        """Give the bytes without a copy."""

    def close(self) -> None:
        """Give it back; raises BufferError while something still looks at it."""


class Kernel(Protocol):
    """Calls of the system; each raises OSError as the system does."""

    def open(self, path: str) -> int:
        """Open a device for reading and writing, without ever waiting; return its file."""

    def ioctl(self, file: int, request: int, structure: ctypes.Structure | ctypes.c_int) -> None:
        """Make a request whose answer is written into `structure`."""

    def mmap(self, file: int, length: int, offset: int) -> Memory:
        """Map a buffer into this process, to be read."""

    def close(self, file: int) -> None:
        """Close a file."""


class LinuxKernel:
    """The kernel of this machine."""

    def open(self, path: str) -> int:
        """Open a device for reading and writing, without ever waiting; return its file."""
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def ioctl(self, file: int, request: int, structure: ctypes.Structure | ctypes.c_int) -> None:
        """Make a request whose answer is written into `structure`."""
        fcntl.ioctl(file, request, structure)

    def mmap(self, file: int, length: int, offset: int) -> mmap.mmap:
        """Map a buffer into this process, to be read."""
        return mmap.mmap(file, length, mmap.MAP_SHARED, mmap.PROT_READ, offset=offset)

    def close(self, file: int) -> None:
        """Close a file."""
        os.close(file)
