"""A webcam as a device: what is sensed of its newest frame."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import ClassVar, Literal

from rtagent.clock import current
from rtagent.device import Device
from rtagent.errors import ClockError, DisconnectedError, SpecError
from rtagent.experience import Command, Sample
from rtagent.specs import DeviceSpec
from rtagent.units import Duration, Frequency, describe, second
from rtagent_drivers.webcam import jpeg
from rtagent_drivers.webcam.features import Features, Region
from rtagent_drivers.webcam.opencv_camera import OpenCVCamera
from rtagent_drivers.webcam.settings import A_SCENE, FakeCamera
from rtagent_drivers.webcam.shots import BackEnd, FormatName, Shot, Wanted
from rtagent_drivers.webcam.v4l2_camera import V4L2Camera

FIRST_WITHIN = 5 * second
"""A camera that was just opened may take so long for its first frame."""

LARGEST_SIDE = 8192
HIGHEST_RATE = 1000.0


class Webcam:
    """A webcam: mean colours of its newest frame and of parts of it, and frames with fewer pixels.

    `world_time` is the kernel's stamp of the frame (`time_source` "device") where the camera's driver gives one of
    the monotonic clock that is not in the future, else its arrival ("arrival"). What is sensed of a frame is
    computed when it is read, once. A camera that gives no frame for `silence` is taken for gone, to be opened anew.
    Raises `SpecError` for settings that do not fit together.
    """

    fakes: ClassVar[Mapping[str, Callable[..., Device]]]

    def __init__(
        self,
        *,
        device: str = "/dev/video0",
        backend: Literal["v4l2", "opencv"] = "v4l2",
        format: FormatName = "YUYV",  # noqa: A002  # as V4L2 calls it
        width: int = 640,
        height: int = 480,
        rate: Frequency = 15.0,
        means: bool = True,
        regions: dict[str, Region] | None = None,
        frame: tuple[int, int] | None = None,
        silence: Duration = 2 * second,
        fake: FakeCamera = A_SCENE,
    ) -> None:
        _check(width, height, rate, silence)
        self.size = (width, height)
        self.features = Features(self.size, means, regions or {}, frame)
        self.spec = DeviceSpec(sensors=self.features.specs, rate=rate)
        self._wanted = Wanted(device, format, width, height, rate)
        self.back_end: BackEnd = _back_end(backend, format)
        self._silence = silence
        self._opened = False
        self._sample: Sample | None = None
        self._next = self._first = 0

    async def open(self) -> None:
        """Begin to stream, and wait for the first frame; raise `DisconnectedError` where none comes."""
        self._clock, self._event = current(), asyncio.Event()
        if self._clock.virtual:
            raise ClockError(
                "a webcam needs the real world, which does not wait for a virtual clock: run with --clock real, or "
                "with --fake=process."
            )
        self._first, self._sample = self._next, None
        try:
            await self.back_end.open(self._wanted, self.features, self._event.set)
            self._opened, self._heard_at = True, self._clock.now() + max(FIRST_WITHIN - self._silence, 0)
            while self._newest() is None:
                await self._wait()
        except BaseException:
            await self.close()
            raise
        self._heard_at = self.back_end.heard_at

    async def read(self, newer_than: int) -> Sample:
        """Return what is sensed of the newest frame, or wait for one above `newer_than`."""
        while True:
            shot = self._newest()
            if shot is not None and self._first + shot.sequence > newer_than:
                sample = await self._sensed(shot)
                if sample.sequence > newer_than:
                    return sample
            else:
                await self._wait()

    async def act(self, command: Command) -> Command:
        """Refuse: it only looks."""
        for name in command:
            raise SpecError(f"a webcam has no actuator {name!r}.")
        return {}

    async def make_safe(self) -> None:
        """Do nothing: it moves nothing."""

    async def close(self) -> None:
        """Let go of the camera."""
        if self._opened:
            self._opened = False
            self._event.set()  # who waits is told
        await self.back_end.close()

    @property
    def counters(self) -> Mapping[str, int]:
        """Frames that were lost, damaged, or overtaken by a newer one; stamps ahead of their arrival."""
        return +self.back_end.counters

    def _newest(self) -> Shot | None:
        """Return the newest shot; raise `DisconnectedError` where the camera is closed, gone, or silent."""
        if not self._opened:
            raise DisconnectedError("the webcam is closed: open it first.")
        shot = self.back_end.newest()
        now = self._clock.now()
        self._heard_at = max(self._heard_at, self.back_end.heard_at)
        if now - self._heard_at > self._silence:
            self.back_end.counters["silences"] += 1
            raise DisconnectedError(
                f"{self._wanted.device} has given no frame for {describe(self._silence)} or more: "
                "plug it in anew if that goes on, or give it more time with silence."
            )
        return shot

    async def _sensed(self, shot: Shot) -> Sample:
        """Return the sample of a shot, or of one from a moment before or after it; each is computed once."""
        if self._sample is None or self._sample.sequence != self._first + shot.sequence:
            shot, values = await self.back_end.sensed()
            number = self._first + shot.sequence
            self._sample = Sample(values, shot.time, shot.arrival, number, shot.time_source)
            self._next = max(self._next, number + 1)
        return self._sample

    async def _wait(self) -> None:
        """Wait until the back end tells of something, at most until the camera has been silent for too long."""
        self._event.clear()
        left = self._heard_at + self._silence - self._clock.now()
        try:
            async with asyncio.timeout(max(left, 0) / second):
                await self._event.wait()
        except TimeoutError:
            return


def _check(width: int, height: int, rate: float, silence: int) -> None:
    if not (4 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE and width % 2 == 0):
        raise SpecError(
            f"{width} × {height} pixels is no size of a picture: give an even width, up to {LARGEST_SIDE}."
        )
    if not 0.0 < rate <= HIGHEST_RATE:
        raise SpecError(f"rate is {rate:g} Hz: give what the camera runs at, such as 15Hz or 30Hz.")
    if silence <= 2 * second / rate:
        raise SpecError("silence is not longer than two frames take: give it more.")


def _back_end(name: str, format_: FormatName) -> BackEnd:
    if name == "opencv":
        return OpenCVCamera()
    return V4L2Camera(jpeg.decoder() if format_ == "MJPG" else None)


def _in_process(**settings: object) -> Device:
    from rtagent_drivers.webcam.fakes import in_process

    return in_process(**settings)


def _on_wire(**settings: object) -> Device:
    from rtagent_drivers.webcam.fakes import on_wire

    return on_wire(**settings)


Webcam.fakes = {"process": _in_process, "wire": _on_wire}
