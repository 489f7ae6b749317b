"""The button: a key of a terminal, messages from sockets, fakes; nothing that was pressed is lost."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import pty
import socket
import stat
import termios
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import virtually
from hypothesis import given
from hypothesis import strategies as st

from rtagent import Agent, Limits, Plan, Schedule, run
from rtagent.clock import ClockName, current
from rtagent.errors import DisconnectedError, SpecError
from rtagent.experience import Observation, Sample, Stimulus
from rtagent.features import Binned
from rtagent.instruments import Instrument
from rtagent.keys import BEGIN, END, Key, Keys
from rtagent.learning import TD
from rtagent.schedule import LEARN, OBSERVE, Wait
from rtagent.specs import Spec
from rtagent.tasks import Signals
from rtagent.terminal import listen
from rtagent.testing import DeviceContract
from rtagent.units import ms, second
from rtagent_drivers.button import Button
from rtagent_drivers.button.fake_presses import FakePresses
from rtagent_drivers.button.presses import MOST_WAITING, Change, Presses


def free_port() -> int:
    with socket.socket() as asking:
        asking.bind(("127.0.0.1", 0))
        port: int = asking.getsockname()[1]
        return port


# The contract, of the driver and of its fakes


class TestTCP(DeviceContract):
    def make_device(self):  # type: ignore[no-untyped-def]  # as a user would write it
        return Button(source="tcp", port=free_port())


class TestUnix(DeviceContract):
    @pytest.fixture(autouse=True)
    def place(self, tmp_path: Path) -> None:
        self.path = str(tmp_path / "button")

    def make_device(self):  # type: ignore[no-untyped-def]
        return Button(source="unix", path=self.path)


class TestKeyboard(DeviceContract):
    @pytest.fixture(autouse=True)
    def terminal(self, monkeypatch: pytest.MonkeyPatch) -> Any:
        self.other_end, self.file = pty.openpty()
        monkeypatch.setattr(os, "tcgetpgrp", lambda file: os.getpgrp())
        yield
        os.close(self.other_end)
        os.close(self.file)

    def make_device(self):  # type: ignore[no-untyped-def]
        button = Button()
        button._source.file = self.file  # type: ignore[attr-defined]  # in place of standard input
        return button


class TestFakeInTheProcess(DeviceContract):
    def make_device(self):  # type: ignore[no-untyped-def]
        return Button.fakes["process"](fake=FakePresses((2 * ms, 5 * ms), (1 * ms, 3 * ms)))


class TestFakeInVirtualTime(TestFakeInTheProcess):
    clock: ClockName = "virtual"


# What is shown


class Told:
    """The changes that a button is told of, read one after the other."""

    def __init__(self, shortest: int = 0) -> None:
        self.presses, self.now = Presses(shortest), 1000
        self.presses.begin(self.now)

    def tell(self, *pressed: bool) -> None:
        for each in pressed:
            self.now += 10
            self.presses.add(Change(each, self.now, self.now, "arrival"))

    def read_all(self) -> list[Sample]:
        samples = [self.presses.sample(self.now)]
        while (due := self.presses.due) is not None:
            self.now = max(self.now, due)
            samples.append(self.presses.sample(self.now))
        return samples


def flags(samples: list[Sample]) -> list[bool]:
    return [bool(sample.values["pressed"]) for sample in samples]


def test_a_press_that_nobody_looked_at_is_shown_afterwards() -> None:
    told = Told()
    told.tell(True, False)
    samples = told.read_all()
    assert flags(samples) == [False, True, False]
    assert [sample.world_time for sample in samples] == [1000, 1010, 1020]
    assert [sample.sequence for sample in samples] == [1, 2, 3]


def test_a_press_stays_for_whoever_looks_twice() -> None:
    told = Told(shortest=5)
    told.presses.sample(1000)
    told.tell(True, False)
    seen = [told.presses.sample(1030 + later).values["pressed"] for later in range(8)]
    assert seen == [True] * 5 + [False] * 3


@given(st.lists(st.sampled_from([True, False, None]), max_size=60))
def test_whatever_comes_whenever_somebody_looks_the_states_alternate_and_end_right(
    steps: list[bool | None],
) -> None:
    told, shown, pressed, true_presses = Told(), [], False, []
    for step in steps:
        if step is None:
            shown.append(told.presses.sample(told.now))
            continue
        told.tell(step)
        if step and not pressed:
            true_presses.append(told.now)
        pressed = step
    shown += told.read_all()
    states = [flag for number, flag in sorted({s.sequence: bool(s.values["pressed"]) for s in shown}.items())]
    assert all(before != after for before, after in itertools.pairwise(states))
    assert states[-1] == pressed
    assert [stimulus.time for stimulus in told.presses.stimuli(0, 10**9)] == true_presses
    left_out = told.presses.counters["presses_not_shown"]
    assert sum(states) + left_out == len(true_presses) == told.presses.counters["presses"]
    assert not left_out or len(true_presses) > MOST_WAITING // 2
    times = [sample.world_time for sample in shown]
    assert times == sorted(times)


def test_an_episode_begins_with_what_is_held_and_without_what_is_past() -> None:
    told = Told()
    told.tell(True, False, True)
    told.presses.begin(5000)
    assert [(sample.world_time, sample.values["pressed"]) for sample in told.read_all()] == [(5000, True)]


# Messages


@asynccontextmanager
async def connected(**settings: Any) -> AsyncIterator[tuple[Button, asyncio.StreamReader, asyncio.StreamWriter]]:
    button = Button(shortest=0, **settings)
    await button.open()
    try:
        if settings["source"] == "unix":
            reader, writer = await asyncio.open_unix_connection(settings["path"])
        else:
            reader, writer = await asyncio.open_connection("127.0.0.1", settings["port"])
        yield button, reader, writer
        writer.close()
    finally:
        await button.close()


async def next_change(button: Button, sample: Sample) -> Sample:
    return await asyncio.wait_for(button.read(sample.sequence), 5)


@pytest.mark.parametrize("source", ["tcp", "unix"])
async def test_messages_press_and_release(source: str, tmp_path: Path) -> None:
    async with connected(source=source, port=free_port(), path=str(tmp_path / "b")) as (button, _, writer):
        before = await button.read(-1)
        await asyncio.sleep(0.005)  # a press from before it was opened would be dated to that
        now = current().now()
        writer.write(json.dumps({"event": "press", "time": now - 3 * ms}).encode() + b'\n{"event": "release"}\n')
        press = await next_change(button, before)
        release = await next_change(button, press)
        assert (press.values["pressed"], release.values["pressed"]) == (True, False)
        assert (press.world_time, press.time_source, release.time_source) == (now - 3 * ms, "device", "arrival")
        assert list(button.stimuli(0, release.world_time)) == [Stimulus(now - 3 * ms, "press", "device")]


@pytest.mark.parametrize("off", [-2 * second, 3 * second, 1 << 80])
async def test_a_time_that_cannot_be_is_not_believed(off: int, tmp_path: Path) -> None:
    async with connected(source="unix", path=str(tmp_path / "b")) as (button, _, writer):
        before = await button.read(-1)
        writer.write(json.dumps({"event": "press", "time": current().now() + off}).encode() + b"\n")
        press = await next_change(button, before)
        assert press.time_source == "arrival"
        assert press.world_time == press.arrival_time
        assert button.counters["times_not_believed"] == 1


BAD = [
    b"press",
    b"[]",
    b"{}",
    b'{"event": "hold"}',
    b'{"event": ["press"]}',
    b'{"event": "press", "time": 1.5}',
    b'{"event": "press", "time": true}',
    b'{"event": "press", "tiem": 1}',
    b"[" * 500,
    b"\xff\xfe",
    b'{"event": "press", "x": "' + b"x" * 600 + b'"}',
]


async def test_a_bad_line_is_answered_and_counted_and_the_next_good_one_is_taken(tmp_path: Path) -> None:
    async with connected(source="unix", path=str(tmp_path / "b")) as (button, reader, writer):
        for line in BAD:
            writer.write(line + b"\n")
            assert json.loads(await reader.readline())["error"]
        before = await button.read(-1)
        assert not before.values["pressed"]
        writer.write(b'{"event": "press"}\n')
        assert (await next_change(button, before)).values["pressed"]
        assert button.counters["lines_refused"] == len(BAD)


async def test_a_line_without_an_end_is_not_kept(tmp_path: Path) -> None:
    async with connected(source="unix", path=str(tmp_path / "b")) as (button, reader, writer):
        writer.write(b"x" * 100_000)
        assert b"longer" in await reader.read()
        assert button.counters["lines_refused"] >= 1


async def test_who_goes_away_lets_go_and_two_can_hold_it(tmp_path: Path) -> None:
    path = str(tmp_path / "b")
    async with connected(source="unix", path=path) as (button, _, writer):
        _, other = await asyncio.open_unix_connection(path)
        before = await button.read(-1)
        writer.write(b'{"event": "press"}\n')
        press = await next_change(button, before)
        other.write(b'{"event": "press"}\n')
        await asyncio.sleep(0.02)
        assert button.counters["presses_again"] == 1
        writer.close()
        await writer.wait_closed()
        await asyncio.sleep(0.01)
        assert (await button.read(-1)).sequence == press.sequence, "the other still holds it"
        other.close()
        assert not (await next_change(button, press)).values["pressed"]


async def test_credentials_are_asked_for_where_they_are_set(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("0123456789abcdef\n")
    settings = {"source": "tcp", "port": free_port(), "token_file": str(tmp_path / "token")}
    async with connected(**settings) as (button, reader, writer):
        writer.write(b'{"event": "press"}\n{"event": "press"}\n')
        assert b"token" in await reader.read()
        assert not (await button.read(-1)).values["pressed"]
        _, trusted = await asyncio.open_connection("127.0.0.1", settings["port"])
        before = await button.read(-1)
        trusted.write(b'{"token": "0123456789abcdef"}\n{"event": "press"}\n')
        assert (await next_change(button, before)).values["pressed"]
        assert button.counters["connections_refused"] == 1
        trusted.close()


async def test_a_socket_is_its_users_own_and_taken_only_where_nobody_listens(tmp_path: Path) -> None:
    path = tmp_path / "b"
    first, second_ = Button(source="unix", path=str(path)), Button(source="unix", path=str(path))
    await first.open()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    with pytest.raises(DisconnectedError, match="take another"):
        await second_.open()
    await first.close()
    assert not path.exists()
    with socket.socket(socket.AF_UNIX) as abandoned:
        abandoned.bind(str(path))
    await second_.open()
    await second_.close()
    path.write_text("mine")
    with pytest.raises(DisconnectedError, match="take another"):
        await first.open()
    assert path.read_text() == "mine"


async def test_a_port_that_is_taken_is_told() -> None:
    port = free_port()
    first, second_ = Button(source="tcp", port=port), Button(source="tcp", port=port)
    await first.open()
    with pytest.raises(DisconnectedError, match="take another"):
        await second_.open()
    await first.close()


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"source": "tcp"}, "needs a port"),
        ({"source": "tcp", "port": 4000, "host": "0.0.0.0"}, "anybody"),  # noqa: S104  # that it is refused
        ({"source": "tcp", "port": 4000, "token_file": "/no/such/file"}, "cannot be read"),
        ({"source": "unix"}, "needs a path"),
        ({"key": "space"}, "stops a run"),
        ({"key": "b2"}, "no key"),
        ({"shortest": -1}, "give times"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        Button(**settings)


# The keyboard


@given(st.binary(max_size=200), st.integers(1, 7))
def test_any_bytes_make_keys_and_the_next_key_is_found(noise: bytes, cut: int) -> None:
    keys = Keys()
    for place in range(0, len(noise), cut):
        keys.feed(noise[place : place + cut])
    keys.feed(b"x" * 80)  # ends whatever was begun
    assert keys.feed(b"b") == [Key("b")]
    assert keys.feed(b"\x1b[98;1:3u") == [Key("b", "release", told=True)]


def test_keys_as_terminals_send_them() -> None:
    keys = Keys()
    assert keys.feed(b"aB \r\x1b") == [Key("a"), Key("b"), Key("space"), Key("enter"), Key("escape")]
    assert keys.feed(b"\x03") == [Key("c", control=True)]
    assert keys.feed(b"\x1b[A\x1b[1;5C") == []
    assert not keys.speaks
    assert keys.feed(b"\x1b[?0") == []
    assert keys.feed(b"u\x1b[98u\x1b[98;1:2u\x1b[98;1:3u\x1b[99;5u") == [
        Key("b", "press", told=True),
        Key("b", "repeat", told=True),
        Key("b", "release", told=True),
        Key("c", "press", control=True, told=True),
    ]
    assert keys.speaks


@asynccontextmanager
async def on_a_terminal(monkeypatch: pytest.MonkeyPatch, **settings: Any) -> AsyncIterator[tuple[Button, int]]:
    other_end, file = pty.openpty()
    monkeypatch.setattr(os, "tcgetpgrp", lambda file: os.getpgrp())
    before = termios.tcgetattr(file)
    button = Button(shortest=0, **settings)
    button._source.file = file  # type: ignore[attr-defined]  # in place of standard input
    try:
        await button.open()
        assert not termios.tcgetattr(file)[3] & (termios.ECHO | termios.ICANON)
        yield button, other_end
    finally:
        await button.close()
        assert termios.tcgetattr(file) == before
        os.close(other_end)
        os.close(file)


async def test_a_terminal_that_tells_no_releases_releases_after_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    async with on_a_terminal(monkeypatch, release_after=30 * ms) as (button, typist):
        before = await button.read(-1)
        os.write(typist, b"xb")
        press = await next_change(button, before)
        release = await next_change(button, press)
        assert (press.values["pressed"], release.values["pressed"]) == (True, False)
        assert release.world_time - press.world_time >= 25 * ms


async def test_a_terminal_that_tells_releases_is_asked_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    async with on_a_terminal(monkeypatch, release_after=1) as (button, typist):
        before = await button.read(-1)
        os.write(typist, b"\x1b[?0u")
        os.write(typist, b"\x1b[98;1:1u")
        press = await next_change(button, before)
        await asyncio.sleep(0.02)
        assert (await button.read(-1)).sequence == press.sequence, "it is released when that is told, not by time"
        os.write(typist, b"\x1b[98;1:3u")
        assert not (await next_change(button, press)).values["pressed"]
        await button.close()
        written = b""
        while END not in written:
            written += os.read(typist, 1000)
        assert BEGIN in written


async def test_who_stops_runs_hears_the_same_keys_and_leaves_signals_to_the_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    other_end, file = pty.openpty()
    monkeypatch.setattr(os, "tcgetpgrp", lambda file: os.getpgrp())
    stops: list[Key] = []
    stop_listening = listen(stops.append, file)
    assert stop_listening is not None
    button = Button(shortest=0)
    button._source.file = file  # type: ignore[attr-defined]  # in place of standard input
    await button.open()
    os.write(other_end, b"\x1b[?0ub ")
    before = await button.read(-1)
    await next_change(button, before)
    assert stops == [Key("b"), Key("space")]
    await button.close()
    os.write(other_end, b"s")
    await asyncio.sleep(0.05)
    assert stops[-1] == Key("s")
    stop_listening()
    os.write(file, b"end")
    written = b""
    while b"end" not in written:
        written += os.read(other_end, 1000)
    assert BEGIN not in written
    os.close(other_end)
    os.close(file)


async def test_without_a_terminal_there_is_no_keyboard() -> None:
    button = Button()
    reading, writing = os.pipe()
    button._source.file = reading  # type: ignore[attr-defined]
    with pytest.raises(DisconnectedError, match="no terminal"):
        await button.open()
    os.close(reading)
    os.close(writing)


# Fakes, and a run


async def test_the_driver_on_the_wire_is_pressed_by_a_process() -> None:
    button = Button.fakes["wire"](fake=FakePresses((5 * ms, 10 * ms), (2 * ms, 4 * ms)), shortest=1)
    await button.open()
    sample = await button.read(-1)
    samples = [sample := await asyncio.wait_for(button.read(sample.sequence), 10) for _ in range(6)]
    await button.close()
    assert flags(samples) == [True, False] * 3
    assert {sample.time_source for sample in samples} == {"device"}
    assert not any(name.startswith("lines") for name in button.counters)  # type: ignore[attr-defined]


def test_a_run_sees_every_press_however_short() -> None:
    """Presses of 2 to 4 ms, looked at every 50 ms."""
    fake = FakePresses((60 * ms, 200 * ms), (2 * ms, 4 * ms))
    button = Button.fakes["process"](fake=fake)
    seen: list[bool] = []
    stimuli: list[Stimulus] = []

    class Spy(Instrument):
        def observed(self, observation: Observation, new: Any) -> None:
            seen.append(bool(observation.samples["button"].values["pressed"]))
            stimuli.extend(new)

    async def main() -> None:
        task = Signals(signals=("button.pressed",))
        task.bind({"button": button.spec})
        agent = Agent(Binned(state={"pressed": Spec.flag()}, bins=2), TD(size=2))
        schedule = Schedule((OBSERVE, LEARN), period=50 * ms, observe=Wait.LATEST)
        await run(
            {"button": button},
            task,
            agent,
            schedule,
            Plan(limits=Limits(episode_time=5 * second)),
            instruments=[Spy()],
        )

    virtually(main())
    presses = sum(now and not before for before, now in itertools.pairwise(seen))
    assert presses == len(stimuli) > 20


def test_the_fake_meets_the_same_presses_whoever_looks() -> None:
    async def times(looks: int) -> list[int]:
        button = Button.fakes["process"]()
        await button.open()
        began = current().now()
        await button.begin_episode(np.random.default_rng(7))  # type: ignore[attr-defined]
        for _ in range(looks):
            await current().sleep_until(current().now() + 30 * second // looks)
            await button.read(-1)
        return [stimulus.time - began for stimulus in button.stimuli(began, began + 30 * second)]  # type: ignore[attr-defined]

    assert virtually(times(1)) == virtually(times(500))
