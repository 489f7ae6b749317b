"""What is asked of the kernel, as the C header has it; streams over an emulated kernel."""

from __future__ import annotations

import ctypes
import errno
from collections import Counter

import numpy as np
import pytest

from rtagent.errors import DisconnectedError
from rtagent.units import ms
from rtagent_drivers.webcam import v4l2
from rtagent_drivers.webcam.shots import Dates, Wanted
from rtagent_drivers.webcam.stream import Stream, explained

# What gcc prints for VIDIOC_… and offsetof(struct v4l2_buffer, …) on x86-64 and aarch64
REQUESTS = {
    "QUERYCAP": 0x80685600,
    "ENUM_FMT": 0xC0405602,
    "S_FMT": 0xC0D05605,
    "REQBUFS": 0xC0145608,
    "QUERYBUF": 0xC0585609,
    "QBUF": 0xC058560F,
    "DQBUF": 0xC0585611,
    "STREAMON": 0x40045612,
    "STREAMOFF": 0x40045613,
    "S_PARM": 0xC0CC5616,
    "S_CTRL": 0xC008561C,
    "QUERYCTRL": 0xC0445624,
}
WANTED = Wanted("/dev/video0", "YUYV", 64, 48, 15.0)


@pytest.mark.parametrize("name", REQUESTS)
def test_requests_are_those_of_the_header(name: str) -> None:
    assert getattr(v4l2, name) == REQUESTS[name]


def test_structures_are_laid_out_as_in_the_header() -> None:
    buffer = v4l2.Buffer
    assert [buffer.seconds.offset, buffer.sequence.offset, buffer.offset.offset, buffer.length.offset] == [
        24,
        56,
        64,
        72,
    ]
    assert (v4l2.Format.width.offset, v4l2.Parameters.numerator.offset) == (8, 12)
    assert v4l2.fourcc("YUYV") == 0x56595559
    assert v4l2.fourcc_name(0x47504A4D) == "MJPG"


class ScriptedKernel:
    """A kernel that gives the buffers of a script: (sequence, flags) or an error number, then nothing yet."""

    def __init__(self, script: list[tuple[int, int] | int], **answers: int) -> None:
        self.script, self.answers = script, answers
        self.free: list[int] = []
        self.closed: list[int] = []
        self.stamp = 5 * ms

    def open(self, path: str) -> int:
        return 7

    def ioctl(self, file: int, request: int, structure: ctypes.Structure) -> None:
        if request == v4l2.QUERYCAP:
            structure.capabilities = self.answers.get("capabilities", v4l2.CAN_CAPTURE | v4l2.CAN_STREAM)
        elif request == v4l2.S_FMT:
            structure.bytesperline, structure.pixelformat = 128, self.answers.get("format", structure.pixelformat)
            structure.width = self.answers.get("width", structure.width)
        elif request == v4l2.S_PARM:
            structure.capability = self.answers.get("capability", v4l2.CAN_SET_RATE)
            structure.denominator = self.answers.get("rate", 15) * structure.numerator
        elif request == v4l2.QBUF:
            self.free.append(structure.index)
        elif request == v4l2.DQBUF:
            self._fill(structure)

    def _fill(self, buffer: v4l2.Buffer) -> None:
        if not self.script or not self.free:
            raise BlockingIOError(errno.EAGAIN, "nothing yet")
        following = self.script.pop(0)
        if isinstance(following, int):
            raise OSError(following, "as scripted")
        buffer.sequence, buffer.flags = following
        buffer.index, buffer.bytesused, buffer.microseconds = self.free.pop(0), 128 * 48, self.stamp // 1000

    def mmap(self, file: int, length: int, offset: int) -> bytearray:
        return bytearray(128 * 48)

    def unmap(self, memory: object) -> None: ...

    def close(self, file: int) -> None:
        self.closed.append(file)


MONOTONIC = v4l2.CLOCK_MONOTONIC


def streaming(script: list[tuple[int, int] | int]) -> tuple[Stream, ScriptedKernel]:
    kernel = ScriptedKernel(script)
    return Stream(kernel, WANTED, Counter()), kernel


def test_a_stream_is_drained_to_the_newest_frame_and_holds_only_that() -> None:
    stream, kernel = streaming([(3, MONOTONIC), (4, MONOTONIC), (6, MONOTONIC)])
    stream.drain(lambda: 10 * ms)
    assert stream.newest is not None
    assert (stream.newest.sequence, stream.newest.time, stream.newest.arrival) == (3, 5 * ms, 10 * ms)
    assert stream.counters == {"frames_overtaken": 2, "frames_lost": 1}
    assert len(kernel.free) == 3
    kernel.script = [(7, MONOTONIC)]
    stream.drain(lambda: 20 * ms)
    assert stream.newest.sequence == 4
    assert sorted(kernel.free) != sorted(set(range(4)))
    assert len(kernel.free) == 3


def test_numbers_that_begin_anew_after_32_bits_are_no_gap() -> None:
    stream, _ = streaming([(2**32 - 1, MONOTONIC), (0, MONOTONIC), (2, MONOTONIC)])
    stream.drain(lambda: 10 * ms)
    assert stream.counters["frames_lost"] == 1
    assert stream.newest is not None
    assert stream.newest.sequence == 3


def test_damaged_frames_and_errors_that_pass_are_counted_and_left_out() -> None:
    stream, kernel = streaming([(0, MONOTONIC), (1, MONOTONIC | v4l2.DAMAGED), errno.EIO])
    stream.drain(lambda: 10 * ms)
    assert stream.newest is not None
    assert stream.newest.sequence == 0
    assert stream.counters == {"frames_damaged": 2, "frames_lost": 0}
    assert len(kernel.free) == 3


def test_an_unplugged_camera_is_told() -> None:
    stream, _ = streaming([(0, MONOTONIC), errno.ENODEV])
    with pytest.raises(DisconnectedError, match="unplugged: plug it in"):
        stream.drain(lambda: 10 * ms)


def test_a_file_that_is_ready_and_gives_nothing_does_not_keep_the_loop_busy() -> None:
    stream, _ = streaming([])
    for _ in range(16):
        stream.drain(lambda: 0, ready=True)
    with pytest.raises(DisconnectedError, match="gives none"):
        stream.drain(lambda: 0, ready=True)


def test_a_stamp_without_a_clock_is_the_arrival() -> None:
    stream, _ = streaming([(0, 0)])
    stream.drain(lambda: 10 * ms)
    assert stream.newest is not None
    assert (stream.newest.time, stream.newest.time_source) == (10 * ms, "arrival")


def test_times_are_never_in_the_future_and_never_go_back() -> None:
    counters: Counter[str] = Counter()
    dates = Dates(counters)
    shots = [dates.shot(stamp, now, 0) for stamp, now in ((5, 10), (25, 20), (3, 30), (None, 40), (41, 42))]
    assert [shot.time for shot in shots] == [5, 20, 20, 40, 41]
    assert [shot.time_source for shot in shots] == ["device", "arrival", "device", "arrival", "device"]
    assert counters == {"stamps_ahead": 1}


@pytest.mark.parametrize(
    ("answers", "sentence"),
    [
        ({"capabilities": v4l2.CAN_CAPTURE}, "gives no pictures"),
        ({"format": v4l2.fourcc("MJPG")}, "has no format YUYV, but MJPG: set format"),
        ({"width": 80}, "the nearest are of 80 × 48"),
        ({"rate": 30}, 'set rate = "30Hz"'),
    ],
)
def test_what_a_camera_has_not_is_refused_with_what_it_has(answers: dict[str, int], sentence: str) -> None:
    kernel = ScriptedKernel([], **answers)
    original = kernel.ioctl

    def ioctl(file: int, request: int, structure: ctypes.Structure) -> None:
        if request == v4l2.ENUM_FMT:
            raise OSError(errno.EINVAL, "no more")
        original(file, request, structure)

    kernel.ioctl = ioctl  # type: ignore[method-assign]
    with pytest.raises(DisconnectedError, match=sentence):
        Stream(kernel, WANTED, Counter())
    assert kernel.closed == [7]


@pytest.mark.parametrize(
    ("number", "sentence"),
    [
        (errno.ENOENT, "plug it in; this machine has"),
        (errno.EACCES, "usermod -aG video"),
        (errno.EBUSY, "end that first"),
        (errno.ENOSPC, "another port, or MJPG"),
        (errno.ENOTTY, "no camera that streams"),
        (errno.EPROTO, "plug it in again"),
    ],
)
def test_errors_are_told_with_their_cure(number: int, sentence: str) -> None:
    assert sentence in str(explained("/dev/video0", OSError(number, "so")))


def test_a_frame_that_is_too_short_is_not_read_beyond_its_end() -> None:
    stream, kernel = streaming([(0, MONOTONIC)])
    stream.drain(lambda: 10 * ms)
    assert stream.picture().rows.shape == (48, 128)
    held = stream._held
    assert held is not None
    held.bytesused = 100
    with pytest.raises(DisconnectedError, match="100 bytes"):
        stream.picture()
    assert np.asarray(kernel.free).size == 3
