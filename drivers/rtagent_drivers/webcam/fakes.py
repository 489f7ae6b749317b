"""The webcam's fakes: a world in the process, and the driver itself on an emulated camera."""

from __future__ import annotations

from threading import Event
from typing import Any

from rtagent.clock import RealClock
from rtagent.device import Device
from rtagent.errors import SpecError
from rtagent.streams import stream
from rtagent.units import second
from rtagent_drivers.fake import FakeDevice, Faults, Sampling
from rtagent_drivers.webcam.driver import Webcam
from rtagent_drivers.webcam.emulated import EmulatedKernel
from rtagent_drivers.webcam.film import Film, FilmDevice, read_film
from rtagent_drivers.webcam.opencv_camera import OpenCVCamera
from rtagent_drivers.webcam.pictures import Pixels
from rtagent_drivers.webcam.scenes import CameraWorld, Clip, Scene, SceneClip
from rtagent_drivers.webcam.settings import FakeCamera
from rtagent_drivers.webcam.v4l2_camera import V4L2Camera


def in_process(**settings: Any) -> Device:
    """Return a world before a camera, or a film, as a device; it works under both clocks."""
    camera = Webcam(**settings | {"backend": "v4l2", "format": "YUYV"})
    fake, size, rate = _fake(settings), camera.size, camera.spec.rate
    if not fake.file:
        sampling = Sampling(rate, fake.delay, fake.jitter)
        return FakeDevice(CameraWorld(size, camera.features), sampling, fake.faults)
    if fake.faults != Faults() or fake.jitter:
        raise SpecError("a film in the process has no faults and no jitter: give --fake=wire.")
    return FilmDevice(_film(fake, size, rate), camera.features, fake.delay)


def on_wire(**settings: Any) -> Device:
    """Return the driver itself, on a camera that is emulated where the driver calls the kernel, or OpenCV."""
    camera, fake = Webcam(**settings), _fake(settings)
    if fake.faults.duplicate or fake.faults.late:
        raise SpecError(
            "a camera's frames are neither doubled nor overtaken on their way: leave that out of faults."
        )
    clip: Clip
    if fake.file:
        clip = _film(fake, camera.size, camera.spec.rate)
    else:
        clip = SceneClip(Scene(camera.size, stream(0, "webcam")), camera.spec.rate)
    if isinstance(camera.back_end, OpenCVCamera):
        camera.back_end = OpenCVCamera(lambda _: ClipCapture(clip, fake))
    elif isinstance(camera.back_end, V4L2Camera):
        camera.back_end.kernel = EmulatedKernel(clip, camera.size, fake.faults, fake.delay, fake.jitter)
    return camera


QUEUE = 4
"""Frames that wait in OpenCV."""


class ClipCapture:
    """A clip behind the interface of cv2.VideoCapture, whose reads block; of the faults it has `hang_at`.

    A read that hangs fails after `gives_up` (ns), as those of OpenCV do after 10 s. The clip began at `began` (ns).
    """

    def __init__(self, clip: Clip, fake: FakeCamera, gives_up: int = 10 * second) -> None:
        self._clip, self._fake, self._gives_up = clip, fake, gives_up
        self.began, self._number = RealClock.now(), -1
        clip.begin(self.began)
        self._hangs_at = sorted(fake.faults.hang_at)
        self._gone = Event()

    def isOpened(self) -> bool:  # noqa: N802  # OpenCV's own name
        """Say that it is there."""
        return True

    def set(self, property_: int, value: float, /) -> bool:
        """Take nothing."""
        return False

    def get(self, property_: int, /) -> float:
        """Return the stamp of the last frame, in ms."""
        return (self.began + self._clip.taken(self._number)) / 1e6

    def grab(self) -> bool:
        """Wait for the next frame, or for the oldest of a short queue."""
        elapsed = RealClock.now() - self.began - self._fake.delay
        self._number += 1
        while self._clip.taken(self._number + QUEUE) < elapsed:
            self._number += 1
        due = self._clip.taken(self._number) + self._fake.delay
        if self._hangs_at and due >= self._hangs_at[0]:
            self._gone.wait(self._gives_up / second)
            return False
        self._gone.wait(max(0, self.began + due - RealClock.now()) / second)
        return True

    def retrieve(self) -> tuple[bool, Pixels]:
        """Return the last frame, BGR."""
        return True, self._clip.pixels(self._number)[:, :, ::-1]

    def release(self) -> None:
        """Let go."""
        self._gone.set()


def _fake(settings: dict[str, Any]) -> FakeCamera:
    fake: FakeCamera = settings.get("fake", FakeCamera())
    return fake


def _film(fake: FakeCamera, size: tuple[int, int], rate: float) -> Film:
    film = read_film(fake.file, size, fake.speed)
    if abs(film.rate - rate) > 0.01 * rate:
        raise SpecError(f'{fake.file} has {film.rate:.4g} frames a second: set rate = "{film.rate:.4g}Hz".')
    return film
