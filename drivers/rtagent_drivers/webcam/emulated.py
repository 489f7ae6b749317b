"""A kernel with one camera that is not there: answers to what the driver asks, frames when they are due.

It stands where system calls leave this process, so that all of the driver is what is tried. As the real kernel
does, it fills the buffers that are queued, oldest first, and loses frames while none is.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Callable
from ctypes import Structure, c_int
from typing import Any, NamedTuple

from rtagent.clock import RealClock
from rtagent.clock.real import EARLY, Timerfd
from rtagent.streams import stream
from rtagent.units import second
from rtagent_drivers.fake import Faults
from rtagent_drivers.webcam import jpeg, v4l2
from rtagent_drivers.webcam.kernel import Memory
from rtagent_drivers.webcam.scenes import Clip

NEVER = 1 << 62


class Filled(NamedTuple):
    """A buffer that holds frame `number`, taken and available at these times (ns)."""

    place: int
    number: int
    taken: int
    available: int
    damaged: bool


class EmulatedKernel:
    """A kernel whose only device is a camera that films `clip`; it begins to exist with the first `open`.

    A frame is available `delay` (ns) after it was taken, and up to `jitter` later. `faults`: `drop` and `corrupt`
    of frames, `raise_at` (EIO), `hang_at` (no frames until it is opened anew), `disconnect` (it is not there).
    `stamp_ahead` (ns) is how far its stamps lie ahead.
    """

    def __init__(
        self,
        clip: Clip,
        size: tuple[int, int],
        faults: Faults,
        delay: int = 0,
        jitter: int = 0,
        stamp_ahead: int = 0,
    ) -> None:
        self._clip, self._size, self._faults = clip, size, faults
        self._delay, self._jitter, self._stamp_ahead = delay, jitter, stamp_ahead
        self._rng = stream(0, "webcam")
        self._raise_at = sorted(faults.raise_at)
        self._began: int | None = None
        self._opened_at = 0
        self._files: dict[int, Timerfd] = {}
        self._memories: list[bytearray] = []
        self._requests: dict[int, Callable[[Any], None]] = {
            v4l2.QUERYCAP: self._describe,
            v4l2.ENUM_FMT: self._name_format,
            v4l2.S_FMT: self._set_format,
            v4l2.S_PARM: self._set_rate,
            v4l2.REQBUFS: self._make_buffers,
            v4l2.QUERYBUF: self._locate,
            v4l2.QBUF: self._queue,
            v4l2.DQBUF: self._dequeue,
            v4l2.STREAMON: self._start,
            v4l2.STREAMOFF: self._stop,
        }

    # The calls

    def open(self, path: str) -> int:
        """Open the camera, whatever its path; once at a time."""
        now = RealClock.now()
        if self._began is None:
            self._began = now
            self._clip.begin(now)
        if self._gone(now):
            raise OSError(errno.ENOENT, "no such file", path)
        if self._files:
            raise OSError(errno.EBUSY, "in use", path)
        self._opened_at, self._streams = now, False
        self._free: deque[int] = deque()
        self._filled: deque[Filled] = deque()
        self._next = 0
        timer = Timerfd()
        self._files[timer.fd] = timer
        file: int = timer.fd
        return file

    def ioctl(self, file: int, request: int, structure: Structure | c_int) -> None:
        """Answer a request."""
        if file not in self._files:
            raise OSError(errno.EBADF, "closed")
        if self._gone(RealClock.now()):
            raise OSError(errno.ENODEV, "unplugged")
        if request not in self._requests:
            raise OSError(errno.ENOTTY, "not known")
        self._requests[request](structure)

    def mmap(self, file: int, length: int, offset: int) -> Memory:
        """Return a buffer, which `offset` numbers."""
        return self._memories[offset]

    def unmap(self, memory: Memory) -> None:
        """Do nothing: its buffers are its own."""

    def close(self, file: int) -> None:
        """Close the camera."""
        self._files.pop(file).close()

    # The requests

    def _describe(self, capability: v4l2.Capability) -> None:
        capability.card = b"emulated camera"
        capability.capabilities = v4l2.CAN_CAPTURE | v4l2.CAN_STREAM

    def _name_format(self, described: v4l2.FormatDescription) -> None:
        if described.index > 1:
            raise OSError(errno.EINVAL, "no more")
        described.pixelformat = v4l2.fourcc(("YUYV", "MJPG")[described.index])

    def _set_format(self, format_: v4l2.Format) -> None:
        if format_.pixelformat not in (v4l2.fourcc("YUYV"), v4l2.fourcc("MJPG")):
            format_.pixelformat = v4l2.fourcc("YUYV")
        self._compressed = format_.pixelformat == v4l2.fourcc("MJPG")
        format_.width, format_.height = self._size
        format_.bytesperline = 2 * self._size[0]
        format_.sizeimage = format_.bytesperline * self._size[1]

    def _set_rate(self, parameters: v4l2.Parameters) -> None:
        parameters.capability = v4l2.CAN_SET_RATE
        parameters.numerator, parameters.denominator = 1000, round(1000 * self._clip.rate)

    def _make_buffers(self, request: v4l2.BufferRequest) -> None:
        self._length = 2 * self._size[0] * self._size[1]
        self._memories = [bytearray(self._length) for _ in range(request.count)]

    def _locate(self, buffer: v4l2.Buffer) -> None:
        buffer.length, buffer.offset = self._length, buffer.index

    def _queue(self, buffer: v4l2.Buffer) -> None:
        self._advance(RealClock.now())
        self._free.append(buffer.index)

    def _start(self, kind: c_int) -> None:
        self._streams, now = True, RealClock.now()
        while self._taken(self._next) < now:  # what was before is nobody's
            self._next += 1
        self._first = self._next
        self._arm(now)

    def _stop(self, kind: c_int) -> None:
        self._streams = False

    def _dequeue(self, buffer: v4l2.Buffer) -> None:
        now = RealClock.now()
        self._advance(now)
        if self._raise_at and now - self._began_at >= self._raise_at[0]:
            self._raise_at.pop(0)
            raise OSError(errno.EIO, "a fault was injected")
        if not self._filled or self._filled[0].available > now:
            self._arm(now)
            raise BlockingIOError(errno.EAGAIN, "nothing yet")
        filled = self._filled.popleft()
        buffer.index, buffer.bytesused = filled.place, self._fill(filled)
        buffer.sequence = filled.number - self._first
        buffer.flags = v4l2.CLOCK_MONOTONIC | (v4l2.DAMAGED if filled.damaged else 0)
        stamp = filled.taken + self._stamp_ahead
        buffer.seconds, buffer.microseconds = stamp // second, stamp % second // 1000

    # The camera

    @property
    def _began_at(self) -> int:
        return self._began or 0

    def _taken(self, number: int) -> int:
        return self._began_at + self._clip.taken(number)

    def _advance(self, now: int) -> None:
        """Film until `now`, into the buffers that are free."""
        while self._streams and self._taken(self._next) <= now:
            number, taken = self._next, self._taken(self._next)
            self._next += 1
            if self._hangs(taken):
                continue
            dropped, damaged = self._rng.random(2) < (self._faults.drop, self._faults.corrupt)
            late = int(self._rng.integers(self._jitter, endpoint=True))
            if self._free and not dropped:
                self._filled.append(
                    Filled(self._free.popleft(), number, taken, taken + self._delay + late, bool(damaged))
                )

    def _fill(self, filled: Filled) -> int:
        number = filled.number
        data = jpeg.encoded(self._clip.pixels(number)) if self._compressed else self._clip.yuyv(number).tobytes()
        self._memories[filled.place][: len(data)] = data
        return len(data)

    def _arm(self, now: int) -> None:
        """Let the file be ready when the next frame is there, or the camera is not."""
        times = [self._filled[0].available if self._filled else self._taken(self._next) + self._delay]
        times += [self._began_at + window[0] for window in self._faults.disconnect]
        wait = min(time for time in [*times, NEVER] if time > now) - now
        for timer in self._files.values():
            timer.arm(wait / second + EARLY)

    def _hangs(self, taken: int) -> bool:
        since = [self._began_at + time for time in self._faults.hang_at]
        return any(self._opened_at <= time <= taken for time in since)

    def _gone(self, now: int) -> bool:
        """Say whether the camera is unplugged, or was since it was opened."""
        elapsed, opened = now - self._began_at, self._opened_at - self._began_at if self._files else NEVER
        return any(
            elapsed >= window[0] and (len(window) == 1 or elapsed < window[1] or opened < window[0])
            for window in self._faults.disconnect
        )
