"""A film: frames from a file, played at their own times; its newest frame is a function of the clock."""

from __future__ import annotations

from bisect import bisect_right
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtagent.clock import current
from rtagent.errors import DisconnectedError, SpecError
from rtagent.experience import Command, Sample
from rtagent.memory import claim
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import DeviceSpec
from rtagent.units import second
from rtagent_drivers.webcam.features import Features
from rtagent_drivers.webcam.pictures import Pixels, as_yuyv, picture_of


class Film:
    """Frames from a file, played again and again at their own times, `speed` times as fast.

    `frames` have the shape (number, height, width, 3); `times` (s) increase.
    """

    def __init__(self, frames: Pixels, times: NDArray[np.float64], speed: float, name: str) -> None:
        if not 0.0 < speed < float("inf"):
            raise SpecError(f"speed is {speed}: give a number above 0.")
        steps = np.diff(times)
        if len(times) < 2 or not (np.isfinite(times).all() and (steps > 0).all()):
            raise SpecError(f"{name}: a film has two frames or more, and times (s) that increase.")
        self._frames = frames
        self._times: list[int] = ((times - times[0]) / speed * second).round().astype(np.int64).tolist()
        interval = round(float(np.median(steps)) / speed * second)
        self._length: int = self._times[-1] + interval
        self.rate = second / interval

    def __len__(self) -> int:
        """Return how many frames it has."""
        return len(self._times)

    def begin(self, now: int) -> None:
        """Do nothing: it begins with its first frame, whenever that is."""

    def taken(self, number: int) -> int:
        """Return when frame `number` is taken; after the last the first follows."""
        rounds, place = divmod(number, len(self._times))
        return rounds * self._length + self._times[place]

    def number(self, time: int) -> int:
        """Return the number of the newest frame at `time`; -1 before the first."""
        rounds, rest = divmod(time, self._length)
        return rounds * len(self._times) + bisect_right(self._times, rest) - 1 if time >= 0 else -1

    def pixels(self, number: int) -> Pixels:
        """Return frame `number`."""
        frame: Pixels = self._frames[number % len(self._times)]
        return frame

    def yuyv(self, number: int) -> Pixels:
        """Return frame `number`: shape (height, 2 · width)."""
        return as_yuyv(self.pixels(number))


def read_film(path: str, size: tuple[int, int], speed: float) -> Film:
    """Read a film: npz with `frames` and `times` (s), or what OpenCV reads; frames are brought to `size`.

    Raises `SpecError` where it cannot be read.
    """
    if not Path(path).is_file():
        raise SpecError(f"there is no file {path}: give a film, an .npz of frames and times or a video.")
    frames, times = _from_npz(path) if path.endswith(".npz") else _from_video(path)
    width, height = size
    claim(len(frames) * height * width * 3, "the frames of a film")
    rows, columns = np.arange(height) * frames.shape[1] // height, np.arange(width) * frames.shape[2] // width
    fits = frames.shape[1:3] == (height, width)
    return Film(frames if fits else frames[:, rows[:, None], columns], times, speed, path)


def _from_npz(path: str) -> tuple[Pixels, NDArray[np.float64]]:
    try:
        with np.load(path, allow_pickle=False) as file:
            frames, times = np.asarray(file["frames"]), np.asarray(file["times"], np.float64)
    except (OSError, ValueError, KeyError) as error:
        raise SpecError(f"{path} is no film: it needs the arrays frames and times ({error}).") from error
    if frames.dtype != np.uint8 or frames.ndim != 4 or frames.shape[3] != 3 or times.shape != frames.shape[:1]:
        raise SpecError(f"{path}: frames are uint8 of shape (number, height, width, 3), times (number,).")
    return frames, times


def _from_video(path: str) -> tuple[Pixels, NDArray[np.float64]]:
    try:
        import cv2
    except ImportError:
        raise SpecError(f'{path} is no .npz; a video needs OpenCV: pip install "rtagent[webcam]".') from None
    video, frames, times = cv2.VideoCapture(path), [], []
    while video.grab():
        times.append(video.get(cv2.CAP_PROP_POS_MSEC) / 1e3)
        frames.append(np.asarray(video.retrieve()[1], np.uint8)[:, :, ::-1])
    video.release()
    if not frames:
        raise SpecError(f"{path} is no video that OpenCV can read.")
    return np.array(frames), np.array(times)


class FilmDevice:
    """A film whose frames reach the host `delay` (ns) after they are due; it begins when it is first opened."""

    def __init__(self, film: Film, features: Features, delay: int) -> None:
        self._film, self._features, self._delay = film, features, delay
        self.spec = DeviceSpec(sensors=features.specs, rate=film.rate)
        self._opened, self._start = False, -1
        self._sample: Sample | None = None

    async def open(self) -> None:
        """Begin to play, or go on."""
        self._clock = current()
        self._opened = True
        if self._start < 0:
            self._start = self._clock.now()

    async def read(self, newer_than: int) -> Sample:
        """Return what is sensed of the newest frame, or wait for one above `newer_than`."""
        self._check_open()
        while (number := self._newest()) <= max(newer_than, -1):
            await self._clock.sleep_until(self._arrival(max(newer_than, number) + 1))
            self._check_open()
        if self._sample is None or self._sample.sequence != number:
            values = self._features(picture_of(self._film.pixels(number)))
            arrival = self._arrival(number)
            self._sample = Sample(values, arrival - self._delay, arrival, number, "device")
        return self._sample

    async def act(self, command: Command) -> Command:
        """Refuse: it can only be watched."""
        for name in command:
            raise SpecError(f"a webcam has no actuator {name!r}.")
        return {}

    async def make_safe(self) -> None:
        """Do nothing: it moves nothing."""

    async def close(self) -> None:
        """Stop looking; it plays on."""
        self._opened = False

    def save(self) -> Saved:
        """Return when it began."""
        return save_fields(self, ("_start",))

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, before it is opened: it then goes on from there."""
        restore_fields(self, ("_start",), saved)

    def next_event(self, now: int) -> int | None:
        """Return when the next frame arrives."""
        return self._arrival(self._film.number(now - self._start - self._delay) + 1)

    def _newest(self) -> int:
        return self._film.number(self._clock.now() - self._start - self._delay)

    def _arrival(self, number: int) -> int:
        return self._start + self._film.taken(number) + self._delay

    def _check_open(self) -> None:
        if not self._opened:
            raise DisconnectedError("the film is closed: open it first.")
