"""The webcam as a device: on an emulated kernel, behind OpenCV, in the process, from a film."""

from __future__ import annotations

import asyncio
import itertools
import subprocess
import sys
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path
from threading import Event
from typing import Any

import cv2
import numpy as np
import pytest

from rtagent import Agent, Limits, Plan, Schedule, clock, run
from rtagent.clock import ClockName, RealClock
from rtagent.device import Device
from rtagent.errors import ClockError, DeviceError, DisconnectedError, SpecError
from rtagent.experience import Observation, Sample
from rtagent.features import Binned
from rtagent.instruments import Instrument
from rtagent.learning import TD
from rtagent.schedule import LEARN, OBSERVE, Wait
from rtagent.specs import Spec
from rtagent.supervision import Supervision
from rtagent.tasks import Signals
from rtagent.testing import DeviceContract
from rtagent.units import ms, second
from rtagent_drivers.fake import Faults
from rtagent_drivers.webcam import Webcam, driver, scenes
from rtagent_drivers.webcam.emulated import EmulatedKernel
from rtagent_drivers.webcam.fakes import ClipCapture
from rtagent_drivers.webcam.features import Region
from rtagent_drivers.webcam.film import read_film
from rtagent_drivers.webcam.opencv_camera import OpenCVCamera
from rtagent_drivers.webcam.pictures import Pixels, as_yuyv
from rtagent_drivers.webcam.settings import FakeCamera
from rtagent_drivers.webcam.v4l2_camera import V4L2Camera

SMALL: dict[str, Any] = {"width": 64, "height": 48, "rate": 200.0, "silence": second}
QUICK = FakeCamera(delay=2 * ms)


def wired(**settings: Any) -> Webcam:
    camera = Webcam.fakes["wire"](**SMALL | {"fake": QUICK} | settings)
    assert isinstance(camera, Webcam)
    return camera


def film_file(path: Path, times: list[float]) -> str:
    """Write a film whose frame n is all of the brightness 20 n."""
    frames = 20 * np.arange(len(times), dtype=np.uint8)[:, None, None, None] * np.ones((1, 48, 64, 3), np.uint8)
    np.savez(path, frames=frames, times=np.array(times))
    return str(path)


# The contract


class TestOnTheWire(DeviceContract):
    def make_device(self) -> Device:
        return wired(frame=(3, 4))


class TestOnTheWireInJPEG(DeviceContract):
    def make_device(self) -> Device:
        return wired(format="MJPG")


class TestOpenCV(DeviceContract):
    def make_device(self) -> Device:
        return wired(backend="opencv")


class TestInTheProcess(DeviceContract):
    def make_device(self) -> Device:
        return Webcam.fakes["process"](**SMALL)


class TestInVirtualTime(TestInTheProcess):
    clock: ClockName = "virtual"


class TestFilm(DeviceContract):
    clock: ClockName = "virtual"

    @pytest.fixture(autouse=True)
    def film(self, tmp_path: Path) -> None:
        self.path = film_file(tmp_path / "film.npz", [0.0, 0.005, 0.01, 0.02, 0.025])

    def make_device(self) -> Device:
        return Webcam.fakes["process"](**SMALL, fake=FakeCamera(file=self.path))


# Frames


async def with_camera(camera: Webcam, use: Callable[[Webcam], Awaitable[Any]]) -> Any:
    await camera.open()
    try:
        return await use(camera)
    finally:
        await camera.close()


def on(make_loop: str, main: Any) -> Any:
    if make_loop == "asyncio":
        return clock.run(main)
    from rtagent.clock.uv import uvloop_loop

    return clock.run(main, make_loop=uvloop_loop)


@pytest.mark.parametrize("make_loop", ["asyncio", "uvloop"])
def test_frames_come_with_the_kernels_stamps(make_loop: str) -> None:
    async def use(camera: Webcam) -> list[Sample]:
        samples = [await camera.read(-1)]
        while len(samples) < 10:
            samples.append(await camera.read(samples[-1].sequence))
        return samples

    samples = on(make_loop, with_camera(wired(), use))
    assert {sample.time_source for sample in samples} == {"device"}
    for before, after in itertools.pairwise(samples):
        steps = (after.world_time - before.world_time) / (5 * ms)
        assert steps == pytest.approx(after.sequence - before.sequence, abs=0.01)
    assert min(sample.arrival_time - sample.world_time for sample in samples) >= 2 * ms


def test_after_the_loop_was_blocked_the_newest_frame_of_the_buffers_is_found_and_then_a_fresh_one() -> None:
    async def use(camera: Webcam) -> None:
        first, before = await camera.read(-1), camera.counters
        await clock.current().compute(60 * ms)  # 12 frames, of which the buffers hold some
        found = await camera.read(-1)
        assert 1 <= found.sequence - first.sequence <= 5, "the buffers were full with these"
        fresh = await camera.read(found.sequence)
        assert fresh.world_time - found.world_time > 20 * ms
        counted = Counter(camera.counters) - Counter(before)
        assert counted["frames_overtaken"] >= 1
        assert counted["frames_lost"] >= 5
        assert fresh.sequence - first.sequence >= counted["frames_overtaken"] + counted["frames_lost"] + 2

    clock.run(with_camera(wired(), use))


def test_frames_that_nobody_looks_at_are_not_looked_into() -> None:
    async def use(camera: Webcam) -> None:
        looked = []
        original = camera.features.__call__

        def counting(picture: Any) -> Any:
            looked.append(picture)
            return original(picture)

        camera.back_end._features = counting  # type: ignore[attr-defined]
        for _ in range(3):
            await asyncio.sleep(0.04)
            sample = await camera.read(-1)
            again = await camera.read(-1)
            assert again is sample or again.sequence > sample.sequence
        assert sample.sequence > 12
        assert 3 <= len(looked) <= 6

    clock.run(with_camera(wired(), use))


def test_regions_and_frames_see_what_stands_where(monkeypatch: pytest.MonkeyPatch) -> None:
    now = clock.RealClock.now()
    monkeypatch.setattr(scenes, "began_on_the_wire", lambda: now)  # else with the first test that emulates a device

    async def use(camera: Webcam) -> Sample:
        return await camera.read(-1)

    regions = {"thumb": Region(0, 20, 8, 8), "wall": Region(40, 40, 8, 8)}
    values = clock.run(with_camera(wired(regions=regions, frame=(3, 4)), use)).values
    assert values["thumb_red"] == pytest.approx(150 / 255, rel=0.06), "light differs from trial to trial"
    assert values["wall_red"] == pytest.approx(8 / 255, abs=0.01)
    assert values["frame"][1, 0].mean() > values["frame"][2, 3].mean() + 0.2


class Patches:
    """A clip of one picture: orange, with a green patch."""

    rate = 200.0

    def begin(self, now: int) -> None:
        pass

    def taken(self, number: int) -> int:
        return number * 5 * ms

    def pixels(self, number: int) -> Pixels:
        pixels = np.full((48, 64, 3), (230, 120, 20), np.uint8)
        pixels[8:40, 16:48] = (40, 170, 60)
        return pixels

    def yuyv(self, number: int) -> Pixels:
        return as_yuyv(self.pixels(number))


@pytest.mark.parametrize("settings", [{}, {"format": "MJPG"}, {"backend": "opencv"}])
def test_the_colours_are_those_of_the_scene_on_every_way(settings: dict[str, str]) -> None:
    regions = {"patch": Region(20, 12, 20, 20), "edge": Region(0, 0, 16, 48)}
    camera = wired(regions=regions, **settings)
    if isinstance(camera.back_end, V4L2Camera):
        camera.back_end.kernel = EmulatedKernel(Patches(), (64, 48), Faults())
    else:
        camera.back_end = OpenCVCamera(lambda wanted: ClipCapture(Patches(), FakeCamera(delay=0)))

    async def use(camera: Webcam) -> Sample:
        return await camera.read(-1)

    values = clock.run(with_camera(camera, use)).values
    for name, colour in (("edge", (230, 120, 20)), ("patch", (40, 170, 60))):
        seen = [values[f"{name}_{each}"] for each in ("red", "green", "blue")]
        assert seen == pytest.approx(np.array(colour) / 255, abs=0.02)


# What goes wrong


def test_lost_and_damaged_frames_are_counted_and_seen_in_the_numbers() -> None:
    async def use(camera: Webcam) -> None:
        sample = first = await camera.read(-1)
        read = 1
        while sample.sequence - first.sequence < 60:
            sample, read = await camera.read(sample.sequence), read + 1
        counters = camera.counters
        missing = counters["frames_lost"] + counters["frames_damaged"] + counters.get("frames_overtaken", 0)
        assert counters["frames_lost"] > 2
        assert counters["frames_damaged"] > 2
        assert sample.sequence - first.sequence + 1 <= read + missing

    faults = Faults(drop=0.2, corrupt=0.2)
    clock.run(with_camera(wired(fake=FakeCamera(faults=faults, delay=ms)), use))


@pytest.mark.parametrize("make_loop", ["asyncio", "uvloop"])
def test_a_camera_that_is_unplugged_ends_a_read_and_comes_back(make_loop: str) -> None:
    faults = Faults(disconnect=((100 * ms,),))
    camera = wired(fake=FakeCamera(faults=faults, delay=ms))

    async def use() -> None:
        await camera.open()
        last = await camera.read(-1)
        with pytest.raises(DisconnectedError, match="unplugged"):
            await camera.read(last.sequence + 1000)
        await camera.close()
        with pytest.raises(DisconnectedError, match="no camera"):
            await camera.open()
        camera.back_end.kernel._faults = Faults()  # type: ignore[attr-defined]  # it is plugged in again
        await camera.open()
        back = await camera.read(-1)
        assert back.sequence > last.sequence
        assert back.world_time > last.world_time
        await camera.close()

    on(make_loop, use())


@pytest.mark.parametrize("settings", [{}, {"backend": "opencv"}])
def test_a_camera_that_gives_nothing_any_more_is_taken_for_gone(settings: dict[str, str]) -> None:
    fake = FakeCamera(faults=Faults(hang_at=(100 * ms,)), delay=ms)
    camera = wired(fake=fake, silence=100 * ms, **settings)

    async def use() -> None:
        await camera.open()
        last = await camera.read(-1)
        began = RealClock.now()
        with pytest.raises(DisconnectedError, match="has given no frame"):
            await camera.read(last.sequence + 1000)
        assert RealClock.now() - began < 5 * second, "within its silence, not only when the read gives up"
        assert camera.counters["silences"] == 1
        await camera.close()

    clock.run(use())
    assert camera.counters.get("threads_left_behind", 0) == ("backend" in settings)


def test_a_run_goes_on_while_the_camera_hangs_and_marks_its_samples() -> None:
    """The camera gives no frames between 150 ms and its return at about 400 ms, in a run of 600 ms."""
    fake = FakeCamera(faults=Faults(hang_at=(150 * ms,)), delay=ms)
    camera = wired(fake=fake, silence=200 * ms)
    ages: list[tuple[int, bool]] = []

    class Spy(Instrument):
        def observed(self, observation: Observation, stimuli: object) -> None:
            ages.append((observation.age("camera"), "camera" in observation.stale))

    async def main() -> Any:
        task = Signals(signals=("camera.red",))
        task.bind({"camera": camera.spec})
        agent = Agent(Binned(state={"red": Spec(low=0.0, high=1.0)}, bins=2), TD(size=2))
        schedule = Schedule((OBSERVE, LEARN), period=10 * ms, observe=Wait.LATEST)
        patience = {"camera": Supervision(timeout=5 * second, stale_after=50 * ms)}
        plan = Plan(limits=Limits(episode_time=600 * ms))
        return await run({"camera": camera}, task, agent, schedule, plan, supervision=patience, instruments=[Spy()])

    result = clock.run(main())
    assert all(stale == (age > 50 * ms) for age, stale in ages)
    marked = [stale for _, stale in ages]
    assert False in marked[marked.index(True) :], "it came back"
    assert result.device_counters["camera"]["reopened"] >= 1
    assert sum(marked) > 5, "the cycles went on meanwhile"


def test_a_thread_that_hangs_is_left_behind_and_nobody_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver, "FIRST_WITHIN", 0)
    free = Event()

    class Hanging:
        def isOpened(self) -> bool:  # noqa: N802  # OpenCV's own name
            return True

        def set(self, *_: object) -> bool:
            return True

        def get(self, _: int) -> float:
            return 0.0

        def grab(self) -> bool:
            return not free.wait(20)

        def retrieve(self) -> tuple[bool, Any]:
            return False, None

        def release(self) -> None: ...

    camera = Webcam(**SMALL | {"backend": "opencv", "silence": 100 * ms})
    camera.back_end = OpenCVCamera(lambda wanted: Hanging())

    async def use() -> None:
        with pytest.raises(DisconnectedError, match="has given no frame"):
            await camera.open()
        assert camera.counters["threads_left_behind"] == 1
        with pytest.raises(DisconnectedError, match="still hangs"):
            await camera.open()
        free.set()
        await asyncio.sleep(0.05)
        with pytest.raises(DisconnectedError, match="gives no frames any more"):
            await camera.open()

    clock.run(use())


def test_opencv_that_cannot_open_a_camera_says_so() -> None:
    async def use() -> None:
        with pytest.raises(DisconnectedError, match="cannot open"):
            await Webcam(backend="opencv", device="/dev/no-camera").open()

    clock.run(use())


def test_a_camera_that_is_not_there_is_told() -> None:
    async def use() -> None:
        with pytest.raises(DisconnectedError, match="no camera /dev/no-camera"):
            await Webcam(device="/dev/no-camera").open()
        with pytest.raises(DisconnectedError, match="no camera that streams"):
            await Webcam(device="/dev/null").open()

    clock.run(use())


@pytest.mark.parametrize("backend", ["v4l2", "opencv"])
def test_a_virtual_clock_is_refused(backend: str) -> None:
    with pytest.raises(ClockError, match="--fake=process"):
        clock.run(wired(backend=backend).open(), "virtual")


def test_a_camera_that_hangs_in_the_kernel_does_not_keep_a_program_from_ending() -> None:
    program = """
import asyncio, threading
from rtagent import clock
from rtagent_drivers.webcam import Webcam
camera = Webcam.fakes["wire"]()
camera.back_end.kernel.open = lambda path: threading.Event().wait()
async def main():
    await asyncio.wait_for(camera.open(), 0.05)
clock.run(main())
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert done.stderr.rstrip().endswith("TimeoutError")


def test_opening_that_is_given_up_leaves_nothing_open() -> None:
    camera = wired()
    kernel = camera.back_end.kernel  # type: ignore[attr-defined]

    async def use() -> None:
        opening = asyncio.ensure_future(camera.open())
        await asyncio.sleep(0)
        opening.cancel()
        await asyncio.wait({opening})
        for _ in range(100):
            await asyncio.sleep(0.001)
        assert not kernel._files
        await camera.open()
        await camera.read(-1)
        await camera.close()
        assert not kernel._files

    clock.run(use())


def test_damaged_jpeg_is_told_and_the_next_picture_taken() -> None:
    camera = wired(format="MJPG")
    original, bad = camera.back_end._decoder, [b"\xff\xd8 no picture"]  # type: ignore[attr-defined]
    camera.back_end._decoder = lambda data: original(bad.pop() if bad else data)  # type: ignore[attr-defined]

    async def use(camera: Webcam) -> Sample:
        with pytest.raises(DeviceError, match="cannot be decoded"):
            await camera.read(-1)
        return await camera.read(0)

    assert clock.run(with_camera(camera, use)).values["red"] > 0


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"width": 63}, "even width"),
        ({"rate": 0.0}, "what the camera runs at"),
        ({"silence": 5 * ms}, "longer than two frames"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        Webcam(**SMALL | settings)


# Films


def test_a_film_is_played_at_its_own_times_and_again(tmp_path: Path) -> None:
    path = film_file(tmp_path / "film.npz", [5.0, 5.1, 5.2, 5.4, 5.5])
    film = Webcam.fakes["process"](**SMALL | {"rate": 10.0}, fake=FakeCamera(path, delay=30 * ms))

    async def main() -> list[tuple[int, int, float]]:
        await film.open()
        began, number, seen = clock.current().now(), -1, []
        for _ in range(7):
            sample = await film.read(number)
            number = sample.sequence
            seen.append(
                ((sample.world_time - began) // ms, (clock.current().now() - began) // ms, sample.values["red"])
            )
        return seen  # type: ignore[return-value]  # red is a float

    times = [0, 100, 200, 400, 500, 600, 700]
    brightness = [0, 1, 2, 3, 4, 0, 1]
    assert clock.run(main(), "virtual") == [
        (time, time + 30, pytest.approx(20 * each / 255)) for time, each in zip(times, brightness, strict=True)
    ]


def test_a_film_on_the_wire_loses_nothing_of_what_is_read(tmp_path: Path) -> None:
    path = film_file(tmp_path / "film.npz", [0.0, 0.01, 0.02, 0.03, 0.04])

    async def use(camera: Webcam) -> None:
        sample = await camera.read(-1)
        offset = None
        for _ in range(8):
            number = round(float(sample.values["red"]) * 255 / 20)  # type: ignore[arg-type]
            offset = (number - sample.sequence) % 5 if offset is None else offset
            assert (number - sample.sequence) % 5 == offset
            sample = await camera.read(sample.sequence)

    clock.run(with_camera(wired(rate=100.0, fake=FakeCamera(path, delay=ms)), use))


def test_a_video_is_read_with_its_times(tmp_path: Path) -> None:
    path = str(tmp_path / "film.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
    for brightness in range(0, 250, 50):
        writer.write(np.full((48, 64, 3), brightness, np.uint8))
    writer.release()
    film = read_film(path, (32, 24), 2.0)
    assert len(film) == 5
    assert film.rate == pytest.approx(40.0)
    assert film.pixels(7).shape == (24, 32, 3)
    assert film.pixels(7).mean() == pytest.approx(100, abs=3)


@pytest.mark.parametrize(
    ("arrays", "sentence"),
    [
        ({"frames": np.zeros((2, 4, 4, 3), np.uint8)}, "needs the arrays"),
        ({"frames": np.zeros((2, 4, 4), np.uint8), "times": [0, 1]}, "uint8 of shape"),
        ({"frames": np.zeros((2, 4, 4, 3), np.uint8), "times": [1, 1]}, "increase"),
        ({"frames": np.array([{}] * 2, object), "times": [0, 1]}, "is no film"),
    ],
)
def test_a_file_that_is_no_film_is_refused(arrays: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "film.npz", **arrays)
    with pytest.raises(SpecError, match=sentence):
        read_film(str(tmp_path / "film.npz"), (4, 4), 1.0)
    with pytest.raises(SpecError, match="no file"):
        read_film(str(tmp_path / "other.npz"), (4, 4), 1.0)
    (tmp_path / "film.mp4").write_bytes(b"no video")
    with pytest.raises(SpecError, match="no video"):
        read_film(str(tmp_path / "film.mp4"), (4, 4), 1.0)


def test_stimuli_are_the_coming_of_objects_and_change_what_is_seen() -> None:
    device = Webcam.fakes["process"](**SMALL | {"rate": 20.0}, regions={"top": Region(28, 0, 8, 2)})

    async def main() -> None:
        await device.open()
        await device.begin_episode(np.random.default_rng(5))  # type: ignore[attr-defined]
        began = clock.current().now()
        stimuli = device.stimuli(began, began + 60 * second)  # type: ignore[attr-defined]
        assert len(stimuli) > 5
        for stimulus in stimuli:
            await clock.current().sleep_until(stimulus.time)
            before = await device.read(-1)
            await clock.current().sleep_until(stimulus.time + 300 * ms)
            after = await device.read(-1)
            assert after.values["top_green"] > before.values["top_green"] + 0.1

    clock.run(main(), "virtual")
