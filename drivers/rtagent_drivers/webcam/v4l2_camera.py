"""The back end "v4l2": a camera of Linux on the event loop, with no thread in the way of a frame."""

from __future__ import annotations

import asyncio
import sys
from collections import Counter
from collections.abc import Callable

from rtagent.clock import current
from rtagent.errors import DisconnectedError
from rtagent.experience import Values
from rtagent_drivers.webcam.features import Features
from rtagent_drivers.webcam.jpeg import Decoder
from rtagent_drivers.webcam.kernel import Kernel, LinuxKernel
from rtagent_drivers.webcam.shots import Shot, Wanted
from rtagent_drivers.webcam.stream import Stream
from rtagent_drivers.webcam.threads import in_thread


class V4L2Camera:
    """A camera of Linux. The loop watches its file; frames stay in the kernel's buffers until they are looked at.

    Opening and closing may take some 100 ms in the kernel and are done by a thread; JPEG is decoded by one too.
    """

    def __init__(self, decoder: Decoder | None = None, kernel: Kernel | None = None) -> None:
        self.counters: Counter[str] = Counter()
        self._decoder = decoder
        self.kernel = kernel
        self._stream: Stream | None = None
        self._error: DisconnectedError | None = None
        self._decoding: asyncio.Future[tuple[Shot, Values]] | None = None

    @property
    def heard_at(self) -> int:
        """When (ns) the last frame came; 0 where none has."""
        newest = self._stream.newest if self._stream is not None else None
        return newest.arrival if newest is not None else 0

    async def open(self, wanted: Wanted, features: Features, told: Callable[[], None]) -> None:
        """Begin to stream; `told` is called when there may be something new. Raises `DisconnectedError`."""
        self._loop, self._now = asyncio.get_running_loop(), current().now
        self._features, self._told, self._error = features, told, None
        if self.kernel is None and sys.platform != "linux":
            raise DisconnectedError('the back end "v4l2" is that of Linux: set backend = "opencv".')
        kernel = self.kernel or LinuxKernel()
        opening = in_thread(Stream, kernel, wanted, self.counters)
        try:
            self._stream = await asyncio.shield(opening)
        except BaseException:
            opening.add_done_callback(_discard)
            raise
        self._loop.add_reader(self._stream.file, self._ready)

    def newest(self) -> Shot | None:
        """Return the newest shot there is, what the loop had no time to see included."""
        if self._error is None:
            self._drain(ready=False)
        if self._error is not None:
            raise self._error
        return self._stream.newest if self._stream is not None else None

    async def sensed(self) -> tuple[Shot, Values]:
        """Return the newest shot and what is sensed of it."""
        stream = self._stream
        if stream is None or stream.newest is None:
            raise DisconnectedError("the webcam is closed: open it first.")
        if self._decoder is None:
            return stream.newest, self._features(stream.picture())
        if self._decoding is None or self._decoding.done():
            data, shot = stream.compressed(), stream.newest
            self._decoding = in_thread(_decoded, self._decoder, self._features, data, shot)
        return await asyncio.shield(self._decoding)

    async def close(self) -> None:
        """Let go of the camera."""
        stream, self._stream = self._stream, None
        if stream is None:
            return
        self._loop.remove_reader(stream.file)
        await asyncio.shield(in_thread(stream.close))

    def _ready(self) -> None:
        self._drain(ready=True)
        self._told()

    def _drain(self, *, ready: bool) -> None:
        if self._stream is None:
            return
        try:
            self._stream.drain(self._now, ready=ready)
        except DisconnectedError as error:
            self._error = error
            self._loop.remove_reader(self._stream.file)


def _decoded(decoder: Decoder, features: Features, data: bytes, shot: Shot) -> tuple[Shot, Values]:
    return shot, features(decoder(data))


def _discard(opening: asyncio.Future[Stream]) -> None:
    """Close a stream that came when nobody waited for it any more."""
    if not opening.cancelled() and opening.exception() is None:
        opening.result().close()
