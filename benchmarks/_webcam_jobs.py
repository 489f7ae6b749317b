"""The webcam beside control: what frames cost, how old they are at use, and what a camera that hangs disturbs."""

from __future__ import annotations

import asyncio
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np
from _components import EmptyCoder, EmptyLearner, EmptyPolicy
from _harness import Row

from rtagent import Agent, Limits, Plan, Schedule, clock, run
from rtagent.clock import RealClock
from rtagent.experience import Command, Observation
from rtagent.instruments import Instrument
from rtagent.schedule import ACT, CHOOSE, OBSERVE, Wait
from rtagent.supervision import Supervision
from rtagent.tasks import Stopping
from rtagent.units import ms, second, us
from rtagent_drivers.fake import Faults
from rtagent_drivers.stopping import stopping_joint
from rtagent_drivers.webcam import Webcam
from rtagent_drivers.webcam.emulated import EmulatedKernel
from rtagent_drivers.webcam.fakes import ClipCapture
from rtagent_drivers.webcam.features import Features, Region
from rtagent_drivers.webcam.opencv_camera import OpenCVCamera
from rtagent_drivers.webcam.pictures import YUYV, Picture, Pixels, as_yuyv, picture_of
from rtagent_drivers.webcam.settings import FakeCamera
from rtagent_drivers.webcam.v4l2_camera import V4L2Camera

RATE, PERIOD, LIMIT, SILENCE = 30.0, 10 * ms, 100 * ms, 500 * ms
WIDTH, HEIGHT = 640, 480
LENGTH = 15 * second
HANGS = (2 * second, 5 * second, 8 * second, 11 * second)
UNPLUGGED = ((3500 * ms, 4200 * ms), (6500 * ms, 7200 * ms), (9500 * ms, 10200 * ms), (12500 * ms, 13200 * ms))
DIGITS = 3
REGIONS = {f"digit_{place}": Region(200 * place, 0, 200, HEIGHT) for place in range(DIGITS)}


class NumberedClip:
    """A clip whose frames show their number: three digits of base 16, each a brightness."""

    rate = RATE

    def taken(self, number: int) -> int:
        """Return when frame `number` was taken (ns)."""
        return round(number * second / RATE)

    def pixels(self, number: int) -> Pixels:
        """Return frame `number`."""
        return np.repeat(self._row(number), HEIGHT, axis=0)

    def yuyv(self, number: int) -> Pixels:
        """Return frame `number`, whose rows are all alike."""
        return np.repeat(as_yuyv(self._row(number)), HEIGHT, axis=0)

    def _row(self, number: int) -> Pixels:
        row = np.zeros((1, WIDTH, 3), np.uint8)
        for place in range(DIGITS):
            row[:, 200 * place : 200 * place + 200] = 16 * (number >> 4 * place & 15)
        return row

    def number(self, values: Mapping[str, Any]) -> int:
        """Return the number that a frame shows."""
        return sum(round(values[f"digit_{place}_green"] * 255 / 16) << 4 * place for place in range(DIGITS))


@dataclass
class Watched(Instrument):
    """What was seen of a run: when each cycle acted, how old its frame truly was, and whether that was marked."""

    clip: NumberedClip
    began: Callable[[], int]
    acts: list[int] = field(default_factory=list)
    ages: list[int] = field(default_factory=list)
    marked: list[bool] = field(default_factory=list)

    def observed(self, observation: Observation, stimuli: object) -> None:
        """Note the true age of the frame, by the number that it shows."""
        if "camera" not in observation.samples:
            return
        taken = self.began() + self.clip.taken(self.clip.number(observation.samples["camera"].values))
        self.ages.append(observation.time - taken)
        self.marked.append("camera" in observation.stale)

    def acted(self, action: int, sent: Mapping[str, Command], start: int, end: int) -> None:
        """Note when it acted."""
        self.acts.append(start)

    def all_periods(self) -> list[int]:
        """Return the periods (ns) of all cycles."""
        return [after - before for before, after in pairwise(self.acts)]

    def periods(self, hanging: bool) -> list[int]:
        """Return the periods (ns) of the cycles in which the camera hung, or worked."""
        return [
            period
            for period, age in zip(self.all_periods(), self.ages[1:], strict=False)
            if (age > 3 * LIMIT // 2) == hanging
        ]


def webcam_rows() -> Iterator[Row]:
    """Yield the rows of the webcam."""
    yield from _costs()
    alone = Watched(NumberedClip(), lambda: 0)
    clock.run(_control(None, alone))
    yield Row("p99 of the period of control without a camera", _p99(alone.all_periods()) / ms, "ms")
    for backend in ("v4l2", "opencv"):
        yield from _hanging(backend)
    yield from _without_the_gil()


def _costs() -> Iterator[Row]:
    pixels = np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    yuyv = Picture(as_yuyv(pixels), WIDTH, YUYV)
    means = Features((WIDTH, HEIGHT), True, {}, None)
    both = Features((WIDTH, HEIGHT), True, {"palm": Region(240, 0, 160, 240)}, (12, 16))
    yield Row("mean colours of a YUYV frame, 640 × 480", _duration(lambda: means(yuyv)) / us, "µs", reach=500.0)
    yield Row("and a region, and 12 × 16 pixels", _duration(lambda: both(yuyv)) / us, "µs", reach=1500.0)
    yield Row("the same of a decoded frame (BGR)", _duration(lambda: both(picture_of(pixels))) / us, "µs")
    yield Row("a read of a frame that was read before", clock.run(_reading_again()) / us, "µs", reach=50.0)


async def _reading_again() -> float:
    camera = _camera("v4l2", NumberedClip(), FakeCamera())
    await camera.open()
    durations = []
    for _ in range(2000):
        before = RealClock.now()
        await camera.read(-1)
        durations.append(RealClock.now() - before)
    await camera.close()
    return median(durations)


def _duration(call: Callable[[], object]) -> float:
    durations = []
    for _ in range(100):
        before = RealClock.now()
        call()
        durations.append(RealClock.now() - before)
    return median(durations)


def _camera(backend: str, clip: NumberedClip, fake: FakeCamera) -> Webcam:
    camera = Webcam(
        backend=backend,  # type: ignore[arg-type]  # one of the two
        rate=RATE,
        regions=REGIONS,
        silence=SILENCE,
    )
    if isinstance(camera.back_end, V4L2Camera):
        camera.back_end.kernel = EmulatedKernel(clip, (WIDTH, HEIGHT), fake.faults, fake.delay, fake.jitter)
    return camera


def _hanging(backend: str) -> Iterator[Row]:
    """Run control at 100 Hz beside a camera that hangs, is unplugged, and loses frames."""
    faults = Faults(drop=0.1, hang_at=HANGS, disconnect=UNPLUGGED if backend == "v4l2" else ())
    fake, clip = FakeCamera(delay=30 * ms, jitter=15 * ms, faults=faults), NumberedClip()
    camera = _camera(backend, clip, fake)
    watched = Watched(clip, lambda: 0)
    if isinstance(camera.back_end, V4L2Camera):
        kernel = camera.back_end.kernel
        watched.began = lambda: kernel._began or 0  # type: ignore[union-attr]  # a benchmark may look inside
    else:
        captures = _Captures(clip, fake)
        camera.back_end = OpenCVCamera(lambda _: captures.open())
        watched.began = lambda: captures.began
    result = clock.run(_control(camera, watched))
    unmarked = [age for age, marked in zip(watched.ages, watched.marked, strict=True) if not marked]
    working, hanging = watched.periods(hanging=False), watched.periods(hanging=True)
    oldest = f"{backend}: oldest frame used without being marked, by its true time"
    yield Row(oldest, max(unmarked) / ms, "ms", reach=LIMIT / ms)
    yield Row(f"{backend}: observations marked", 100 * sum(watched.marked) / len(watched.marked), "%")
    reopened = result.device_counters["camera"]["reopened"]
    yield Row(f"{backend}: opened anew", reopened, "times", reach=3.0, better="higher")
    yield Row(f"{backend}: p99 of the period of control, camera at work", _p99(working) / ms, "ms")
    ratio = _p99(hanging) / _p99(working)
    yield Row(f"{backend}: the same while it hangs or is gone, as a ratio", ratio, "×", reach=1.1)


class _Captures:
    """Captures of one clip that goes on; the first ones hang, each in its turn."""

    def __init__(self, clip: NumberedClip, fake: FakeCamera) -> None:
        self._clip, self._fake, self.began, self._opened = clip, fake, RealClock.now(), 0

    def open(self) -> ClipCapture:
        """Open it."""
        hang = self._fake.faults.hang_at[self._opened : self._opened + 1]
        self._opened += 1
        capture = ClipCapture(self._clip, FakeCamera(delay=self._fake.delay, faults=Faults(hang_at=hang)), LEAVES)
        capture.began = self.began
        return capture


LEAVES = 1500 * ms
"""A read that hangs gives up after so long, as OpenCV's does after 10 s; then the camera can be opened anew."""


async def _control(camera: Webcam | None, watched: Watched) -> Any:
    joint = stopping_joint(onset=(100 * second, 100 * second), velocity=0.01)
    task = Stopping()
    schedule = Schedule((OBSERVE, CHOOSE, ACT), period=PERIOD, observe=Wait.LATEST)
    cameras = {} if camera is None else {"camera": camera}
    patience = dict.fromkeys(cameras, Supervision(timeout=60 * second, stale_after=LIMIT))
    agent = Agent(EmptyCoder(), EmptyLearner(), EmptyPolicy(), np.random.default_rng(0))  # type: ignore[arg-type]
    plan = Plan(limits=Limits(episode_time=LENGTH))
    return await run(
        {"joint": joint, **cameras}, task, agent, schedule, plan, supervision=patience, instruments=[watched]
    )


def _p99(values: Sequence[int]) -> float:
    return float(np.quantile(values, 0.99))


def _without_the_gil() -> Iterator[Row]:
    """Compare how late a loop wakes while a thread decodes real pictures of OpenCV's all the time."""
    with tempfile.TemporaryDirectory() as folder:
        path = _video(Path(folder))
        alone = clock.run(_lateness())
        stop = threading.Event()
        decoding = threading.Thread(target=_decode, args=(path, stop))
        decoding.start()
        try:
            beside = clock.run(_lateness())
        finally:
            stop.set()
            decoding.join()
    yield Row("a sleep of 1 ms ends late, median", median(alone) / us, "µs")
    yield Row("while OpenCV decodes frames in a thread without pause", median(beside) / us, "µs")


async def _lateness() -> list[int]:
    late = []
    for _ in range(2000):
        due = RealClock.now() + ms
        await asyncio.sleep(0.001)
        late.append(RealClock.now() - due)
    return late


def _video(folder: Path) -> str:
    path = str(folder / "video.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (WIDTH, HEIGHT))
    rng = np.random.default_rng(1)
    for _ in range(30):
        writer.write(rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8))
    writer.release()
    return path


def _decode(path: str, stop: threading.Event) -> None:
    while not stop.is_set():
        video = cv2.VideoCapture(path)
        while video.grab() and not stop.is_set():
            video.retrieve()
        video.release()
