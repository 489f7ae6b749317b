"""A stream of a V4L2 camera: opened, negotiated, its buffers mapped, drained to the newest frame; never waiting."""

from __future__ import annotations

import contextlib
import errno
from collections import Counter
from collections.abc import Callable
from ctypes import c_int
from pathlib import Path

import numpy as np

from rtagent.errors import DisconnectedError
from rtagent_drivers.webcam import v4l2
from rtagent_drivers.webcam.kernel import Kernel, Memory
from rtagent_drivers.webcam.pictures import YUYV, Picture
from rtagent_drivers.webcam.shots import Dates, Shot, Wanted

BUFFERS, FEWEST = 4, 2
SAME_RATE = 0.01
MOST_EMPTY = 16
"""So many times in a row a file may be ready with nothing to be had: then it would keep the loop busy."""

WRAP = 1 << 32
"""Sequence numbers of the kernel begin anew after so many."""


class Stream:
    """A camera that streams into buffers. `newest` is the last shot, whose buffer is held until the next comes.

    Raises `DisconnectedError`, with what to do, where that is not to be had. `counters`: `frames_lost` are numbers
    that the camera left out, `frames_overtaken` those that were there together with a newer one.
    """

    def __init__(self, kernel: Kernel, wanted: Wanted, counters: Counter[str]) -> None:
        self._kernel, self._wanted, self.counters = kernel, wanted, counters
        self._memories: list[Memory] = []
        self._held: v4l2.Buffer | None = None
        self._last: int | None = None
        self._sequence = -1
        self._empty, self._dates = 0, Dates(counters)
        self.newest: Shot | None = None
        self.file = self._open()
        try:
            self._negotiate()
            self._map()
            self._ioctl(v4l2.STREAMON, c_int(v4l2.CAPTURE))
        except OSError as error:
            self.close()
            raise explained(wanted.device, error) from error
        except DisconnectedError:
            self.close()
            raise

    def drain(self, now: Callable[[], int], *, ready: bool = False) -> None:
        """Take what has come, and keep the newest; `now` tells the time, `ready`: the file was said to be so."""
        before = self._held
        try:
            while (buffer := self._dequeue()) is not None:
                self._take(buffer, now(), before)
            if before is not None and before is not self._held:
                self._ioctl(v4l2.QBUF, before)
        except OSError as error:
            raise explained(self._wanted.device, error) from error
        self._check_empty(ready and self._held is before)

    def picture(self) -> Picture:
        """Return the newest frame as it lies in its buffer: only until the stream is drained the next time."""
        memory, used = self._held_memory()
        format_ = self._format
        needed = format_.bytesperline * format_.height
        if used < needed:
            raise DisconnectedError(
                f"{self._wanted.device} gave {used} bytes for a frame of {needed}: open it anew."
            )
        rows = np.frombuffer(memory, np.uint8, needed).reshape(format_.height, format_.bytesperline)
        return Picture(rows, format_.width, YUYV)

    def compressed(self) -> bytes:
        """Return a copy of the newest frame's bytes."""
        memory, used = self._held_memory()
        return bytes(memory[:used])

    def close(self) -> None:
        """Stop, and let go of the camera: a buffer that is still mapped would keep it in use."""
        file, self.file = self.file, -1
        if file < 0:
            return
        with contextlib.suppress(OSError):
            self._kernel.ioctl(file, v4l2.STREAMOFF, c_int(v4l2.CAPTURE))
        for memory in self._memories:
            self._kernel.unmap(memory)
        self._memories, self._held = [], None
        with contextlib.suppress(OSError):
            self._kernel.close(file)

    # Opening

    def _open(self) -> int:
        try:
            return self._kernel.open(self._wanted.device)
        except OSError as error:
            raise explained(self._wanted.device, error) from error

    def _ioctl(self, request: int, structure: object) -> None:
        self._kernel.ioctl(self.file, request, structure)  # type: ignore[arg-type]  # a structure, or an int

    def _negotiate(self) -> None:
        device, capability = self._wanted.device, v4l2.Capability()
        self._ioctl(v4l2.QUERYCAP, capability)
        own = capability.capabilities & v4l2.HAS_OWN_CAPABILITIES
        can = capability.device_caps if own else capability.capabilities
        if not (can & v4l2.CAN_CAPTURE and can & v4l2.CAN_STREAM):
            raise DisconnectedError(
                f"{device} gives no pictures: it is another part of a camera; try the next one."
            )
        self._format = self._set_format()
        self._set_rate()

    def _set_format(self) -> v4l2.Format:
        wanted = self._wanted
        format_ = v4l2.Format(
            type=v4l2.CAPTURE,
            width=wanted.width,
            height=wanted.height,
            pixelformat=v4l2.fourcc(wanted.format),
            field=1,  # progressive
        )
        self._ioctl(v4l2.S_FMT, format_)
        got = v4l2.fourcc_name(format_.pixelformat)
        if got != wanted.format:
            there = ", ".join(self._formats()) or got
            raise DisconnectedError(f"{wanted.device} has no format {wanted.format}, but {there}: set format.")
        if (format_.width, format_.height) != (wanted.width, wanted.height):
            raise DisconnectedError(
                f"{wanted.device} has no pictures of {wanted.width} × {wanted.height} pixels: the nearest are of "
                f"{format_.width} × {format_.height}: set width and height."
            )
        return format_

    def _formats(self) -> list[str]:
        found: list[str] = []
        with contextlib.suppress(OSError):  # EINVAL: there are no more
            while True:
                described = v4l2.FormatDescription(index=len(found), type=v4l2.CAPTURE)
                self._ioctl(v4l2.ENUM_FMT, described)
                found.append(v4l2.fourcc_name(described.pixelformat))
        return found

    def _set_rate(self) -> None:
        rate = self._wanted.rate
        parameters = v4l2.Parameters(type=v4l2.CAPTURE, numerator=1000, denominator=round(1000 * rate))
        self._ioctl(v4l2.S_PARM, parameters)
        if not parameters.capability & v4l2.CAN_SET_RATE or not parameters.numerator:
            self.counters["rates_not_settable"] += 1
            return
        got = parameters.denominator / parameters.numerator
        if abs(got - rate) > SAME_RATE * rate:
            raise DisconnectedError(
                f"{self._wanted.device} does not run at {rate:g} Hz, the nearest is {got:.4g} Hz: "
                f'set rate = "{got:.4g}Hz".'
            )

    def _map(self) -> None:
        asked = v4l2.BufferRequest(count=BUFFERS, type=v4l2.CAPTURE, memory=v4l2.MMAP)
        self._ioctl(v4l2.REQBUFS, asked)
        if asked.count < FEWEST:
            raise DisconnectedError(
                f"{self._wanted.device} has too few buffers ({asked.count}): end what else uses it."
            )
        for index in range(asked.count):
            buffer = v4l2.Buffer(index=index, type=v4l2.CAPTURE, memory=v4l2.MMAP)
            self._ioctl(v4l2.QUERYBUF, buffer)
            self._memories.append(self._kernel.mmap(self.file, buffer.length, buffer.offset & 0xFFFFFFFF))
            self._ioctl(v4l2.QBUF, buffer)

    # Streaming

    def _dequeue(self) -> v4l2.Buffer | None:
        """Return the next buffer that is filled; None where there is none."""
        if self.file < 0:
            raise DisconnectedError(f"{self._wanted.device} is closed: open it first.")
        buffer = v4l2.Buffer(type=v4l2.CAPTURE, memory=v4l2.MMAP)
        try:
            self._ioctl(v4l2.DQBUF, buffer)
        except BlockingIOError:
            return None
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self.counters["frames_damaged"] += 1  # the kernel calls that temporary
            return None
        return buffer

    def _take(self, buffer: v4l2.Buffer, now: int, before: v4l2.Buffer | None) -> None:
        """Hold a buffer unless it is damaged, and give back the one held so far, but for the one from `before`."""
        self._number(buffer)
        if buffer.flags & v4l2.DAMAGED:
            self.counters["frames_damaged"] += 1
            self._ioctl(v4l2.QBUF, buffer)
            return
        if self._held is not before and self._held is not None:
            self.counters["frames_overtaken"] += 1
            self._ioctl(v4l2.QBUF, self._held)
        self._held = buffer
        self._date(buffer, now)

    def _number(self, buffer: v4l2.Buffer) -> None:
        """Go on to the number of a frame; those between are lost."""
        step = 1 if self._last is None else (buffer.sequence - self._last) % WRAP
        self._last = buffer.sequence
        self.counters["frames_lost"] += max(step - 1, 0)
        self._sequence += max(step, 1)

    def _date(self, buffer: v4l2.Buffer, now: int) -> None:
        monotonic = buffer.flags & v4l2.CLOCK_MASK == v4l2.CLOCK_MONOTONIC
        stamp = buffer.seconds * 1_000_000_000 + buffer.microseconds * 1000
        self.newest = self._dates.shot(stamp if monotonic else None, now, self._sequence)

    def _check_empty(self, empty: bool) -> None:
        self._empty = self._empty + 1 if empty else 0
        if self._empty > MOST_EMPTY:
            raise DisconnectedError(
                f"{self._wanted.device} says that it has a frame and gives none: plug it in anew if that goes on."
            )

    def _held_memory(self) -> tuple[Memory, int]:
        if self._held is None:
            raise DisconnectedError(f"{self._wanted.device} is closed: open it first.")
        return self._memories[self._held.index], self._held.bytesused


def explained(device: str, error: OSError) -> DisconnectedError:
    """Return what an error of a camera means, with its cure."""
    number = error.errno
    if number in (errno.ENOENT, errno.ENXIO):
        return DisconnectedError(f"there is no camera {device}: plug it in; {_cameras()}.")
    if number in (errno.EACCES, errno.EPERM):
        return DisconnectedError(f"you may not open {device}: run `sudo usermod -aG video $USER` and log in again.")
    if number == errno.EBUSY:
        return DisconnectedError(f"{device} is in use by another program: end that first.")
    if number == errno.ENODEV:
        return DisconnectedError(f"{device} was unplugged: plug it in again.")
    if number == errno.ENOSPC:
        return DisconnectedError(f"{device} finds no room on its USB bus: give it another port, or MJPG as format.")
    if number in (errno.ENOTTY, errno.EINVAL):
        return DisconnectedError(f"{device} is no camera that streams ({error}): name one; {_cameras()}.")
    return DisconnectedError(f"{device} has gone ({error}): plug it in again.")


def _cameras() -> str:
    """Say which cameras this machine has, by names that stay the same, as far as they have one."""
    by_id = [str(path) for path in sorted(Path("/dev/v4l/by-id").glob("*-index0"))]
    there = by_id or [str(path) for path in sorted(Path("/dev").glob("video*"))]
    return f"this machine has {' and '.join(there) or 'none'}"
