"""The back end "opencv": a camera of any system, read by a thread, because OpenCV's reads block.

The thread takes every frame from OpenCV's queue, so that none grows old there. It decodes one only while somebody
looks at them, and OpenCV holds no GIL while it waits or decodes.
"""

from __future__ import annotations

import asyncio
import importlib.util
import sys
import threading
from collections import Counter
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from rtagent.clock import current
from rtagent.errors import DisconnectedError, RtagentError, SpecError
from rtagent.experience import Values
from rtagent.units import ms, second
from rtagent_drivers.webcam.features import Features
from rtagent_drivers.webcam.pictures import BGR, picture_of
from rtagent_drivers.webcam.shots import Dates, Shot, Wanted
from rtagent_drivers.webcam.threads import tell

LOOKED_AT = 1 * second
"""Frames are decoded until nobody has looked for so long."""

CREDIBLE = 10 * second
"""A stamp is the monotonic clock's where it lies within so much of now."""

COUNTED = ("frames_overtaken", "frames_damaged", "stamps_ahead", "threads_left_behind")

GIVE_UP = 200 * ms
"""How long closing waits for the thread; one that hangs in a read is left behind."""


class Capture(Protocol):
    """What of cv2.VideoCapture is used."""

    def isOpened(self) -> bool:  # noqa: N802  # OpenCV's own name
        """Say whether it was opened."""

    def set(self, property_: int, value: float, /) -> bool:
        """Ask for something."""

    def get(self, property_: int, /) -> float:
        """Return what there is."""

    def grab(self) -> bool:
        """Wait for a frame and take it; say whether there was one."""

    def retrieve(self) -> tuple[bool, Any]:
        """Decode the frame that was taken last."""

    def release(self) -> None:
        """Let go."""


class OpenCVCamera:
    """A camera read by OpenCV; `open_capture` opens it, within the thread.

    `counters`: `frames_overtaken` were in OpenCV's queue together with a newer one, `threads_left_behind` hung in a
    read when the camera was closed.
    """

    def __init__(self, open_capture: Callable[[Wanted], Capture] | None = None) -> None:
        if open_capture is None and importlib.util.find_spec("cv2") is None:
            raise SpecError('the back end "opencv" needs OpenCV: pip install "rtagent[webcam]".')
        self.counters = Counter(dict.fromkeys(COUNTED, 0))  # a thread adds to them: no key may come meanwhile
        self._open_capture = open_capture or _capture
        self._grabber: _Grabber | None = None

    @property
    def heard_at(self) -> int:
        """When (ns) the last frame came, decoded or not; 0 where none has."""
        return self._grabber.heard_at if self._grabber is not None else 0

    async def open(self, wanted: Wanted, features: Features, told: Callable[[], None]) -> None:
        """Begin to read; raise `DisconnectedError` where that is impossible, or a former thread still hangs."""
        if self._grabber is not None and self._grabber.alive:
            raise DisconnectedError(
                f"the thread that reads {wanted.device} still hangs in a read: plug the camera in anew."
            )
        grabber = self._grabber = _Grabber(wanted, features, told, self.counters, self._open_capture)
        try:
            await grabber.opened
        except BaseException:
            grabber.stop()
            raise

    def newest(self) -> Shot | None:
        """Return the newest shot that was decoded; after a pause in looking the next follows within a period."""
        if self._grabber is None:
            return None
        if self._grabber.error is not None:
            raise self._grabber.error
        self._grabber.looked_at = current().now()
        return self._grabber.newest[0] if self._grabber.newest else None

    async def sensed(self) -> tuple[Shot, Values]:
        """Return the newest shot and what is sensed of it."""
        if self._grabber is None or self._grabber.newest is None:
            raise DisconnectedError("the webcam is closed: open it first.")
        return self._grabber.newest

    async def close(self) -> None:
        """Have the thread let go of the camera; one that does not come back is left behind, and counted."""
        grabber = self._grabber
        if grabber is None or grabber.stopped:
            return
        grabber.stop()
        await asyncio.wait({grabber.ended}, timeout=GIVE_UP / second)
        if not grabber.ended.done():
            self.counters["threads_left_behind"] += 1


class _Grabber:
    """The thread: takes frames as they come, and decodes those that somebody looks at."""

    def __init__(
        self,
        wanted: Wanted,
        features: Features,
        told: Callable[[], None],
        counters: Counter[str],
        open_capture: Callable[[Wanted], Capture],
    ) -> None:
        self._wanted, self._features, self._told, self._counters = wanted, features, told, counters
        self._open_capture = open_capture
        self._loop, self._now = asyncio.get_running_loop(), current().now
        self.opened: asyncio.Future[None] = self._loop.create_future()
        self.ended: asyncio.Future[None] = self._loop.create_future()
        self.newest: tuple[Shot, Values] | None = None
        self.error: RtagentError | None = None
        self.stopped = False
        self.looked_at, self.heard_at = self._now(), 0
        self._sequence, self._dates = -1, Dates(counters)
        self._thread = threading.Thread(target=self._run, name="webcam", daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread has not let go of the camera yet."""
        return self._thread.is_alive() and not self.ended.done()

    def stop(self) -> None:
        """Ask the thread to end after the frame that it waits for."""
        self.stopped = True

    def _run(self) -> None:
        capture = None
        try:
            capture = self._open_capture(self._wanted)
            self._tell(_settle, self.opened)
            while not self.stopped:
                self._grab(capture)
        except RtagentError as error:
            self._fail(error)
        except Exception as error:  # OpenCV raises errors of its own
            self._fail(DisconnectedError(f"{self._wanted.device} has gone ({error!r}): plug it in again."))
        finally:
            if capture is not None:
                capture.release()
            self._tell(_settle, self.ended)

    def _grab(self, capture: Capture) -> None:
        began = self._now()
        if not capture.grab():
            raise DisconnectedError(f"{self._wanted.device} gives no frames any more: plug it in again.")
        now = self.heard_at = self._now()
        shot = self._dated(capture, now)
        period = second / self._wanted.rate
        if now - began < period / 4 and now - shot.time > period:
            self._counters["frames_overtaken"] += 1  # it waited in the queue: the next is there already
        elif now - self.looked_at < LOOKED_AT:
            self._look(capture, shot)

    def _dated(self, capture: Capture, now: int) -> Shot:
        """Return the frame as a shot; its stamp is the kernel's, where OpenCV hands that on."""
        stamp = round(capture.get(_POS_MSEC) * ms)
        self._sequence += 1
        return self._dates.shot(stamp if abs(now - stamp) < CREDIBLE else None, now, self._sequence)

    def _look(self, capture: Capture, shot: Shot) -> None:
        there, pixels = capture.retrieve()
        if not there:
            self._counters["frames_damaged"] += 1
            return
        self.newest = (shot, self._features(picture_of(np.asarray(pixels, np.uint8), BGR)))
        self._tell(self._told)

    def _fail(self, error: RtagentError) -> None:
        self.error = error
        self._tell(_settle, self.opened, error)
        self._tell(self._told)

    def _tell(self, callback: Callable[..., object], *arguments: object) -> None:
        if not tell(self._loop, callback, *arguments):
            self.stopped = True  # the loop was closed while this thread hung


def _settle(future: asyncio.Future[None], error: RtagentError | None = None) -> None:
    if future.done():
        return
    if error is None:
        future.set_result(None)
    else:
        future.set_exception(error)
        future.exception()  # seen: whoever opened it may have gone


_POS_MSEC, _WIDTH, _HEIGHT, _FPS, _FOURCC, _BUFFERS = 0, 3, 4, 5, 6, 38
"""Properties of cv2.VideoCapture."""


def _capture(wanted: Wanted) -> Capture:
    import cv2

    device = int(wanted.device) if wanted.device.isdigit() else wanted.device
    capture = cv2.VideoCapture(device, cv2.CAP_V4L2 if sys.platform == "linux" else cv2.CAP_ANY)
    if not capture.isOpened():
        raise DisconnectedError(f"OpenCV cannot open {wanted.device}: plug it in, or look who uses it.")
    code = float(int.from_bytes(wanted.format.encode("ascii"), "little"))
    asked = {_FOURCC: code, _WIDTH: wanted.width, _HEIGHT: wanted.height, _FPS: wanted.rate, _BUFFERS: 1}
    for name, value in asked.items():
        capture.set(name, value)
    got = tuple(int(capture.get(each)) for each in (_WIDTH, _HEIGHT))
    if got != (wanted.width, wanted.height):
        capture.release()
        raise DisconnectedError(
            f"{wanted.device} gives pictures of {got[0]} × {got[1]} pixels in place of "
            f"{wanted.width} × {wanted.height}: set width and height."
        )
    rate = capture.get(_FPS)
    if rate > 0 and abs(rate - wanted.rate) > 0.01 * wanted.rate:
        capture.release()
        raise DisconnectedError(f'{wanted.device} runs at {rate:.4g} Hz: set rate = "{rate:.4g}Hz".')
    return capture
