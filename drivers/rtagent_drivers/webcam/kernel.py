"""What a camera asks of the kernel, so that another can take its place."""

from __future__ import annotations

import ctypes
import mmap
import os
from typing import Protocol

Memory = mmap.mmap | bytearray
"""A buffer of the kernel's, mapped into this process."""


class Kernel(Protocol):
    """Calls of the system; each raises OSError as the system does."""

    def open(self, path: str) -> int:
        """Open a device for reading and writing, without ever waiting; return its file."""

    def ioctl(self, file: int, request: int, structure: ctypes.Structure | ctypes.c_int) -> None:
        """Make a request whose answer is written into `structure`."""

    def mmap(self, file: int, length: int, offset: int) -> Memory:
        """Map a buffer into this process, to be read."""

    def unmap(self, memory: Memory) -> None:
        """Give a buffer back."""

    def close(self, file: int) -> None:
        """Close a file."""


class LinuxKernel:
    """The kernel of this machine."""

    def __init__(self) -> None:
        from fcntl import ioctl  # not everywhere where OpenCV and the fakes are

        self._ioctl = ioctl

    def open(self, path: str) -> int:
        """Open a device for reading and writing, without ever waiting; return its file."""
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def ioctl(self, file: int, request: int, structure: ctypes.Structure | ctypes.c_int) -> None:
        """Make a request whose answer is written into `structure`."""
        self._ioctl(file, request, structure)

    def mmap(self, file: int, length: int, offset: int) -> Memory:
        """Map a buffer into this process, to be read."""
        return mmap.mmap(file, length, mmap.MAP_SHARED, mmap.PROT_READ, offset=offset)

    def unmap(self, memory: Memory) -> None:
        """Give a buffer back; while it is mapped its camera stays in use."""
        if isinstance(memory, mmap.mmap):
            memory.close()

    def close(self, file: int) -> None:
        """Close a file."""
        os.close(file)
