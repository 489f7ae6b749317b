from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import termios
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import serial

from rtagent.errors import DisconnectedError
from rtagent_drivers import serial_line
from rtagent_drivers.serial_line import connect, explained, find_port, holders, stable_name


class Heard:
    def __init__(self) -> None:
        self.data = b""
        self.lost: list[DisconnectedError | None] = []

    def data_received(self, data: bytes, /) -> None:
        self.data += data

    def connection_lost(self, error: DisconnectedError | None, /) -> None:
        self.lost.append(error)


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    near, far = os.openpty()
    tty.setraw(far)
    os.set_blocking(near, False)
    yield near, os.ttyname(far)
    for fd in (near, far):
        with contextlib.suppress(OSError):
            os.close(fd)


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(5):
        while not condition():  # noqa: ASYNC110  # what is waited for sends no event
            await asyncio.sleep(0.001)


async def test_bytes_go_both_ways_and_are_sent_at_once(pty: tuple[int, str]) -> None:
    near, path = pty
    heard = Heard()
    line = await connect(path, 57_600, heard)
    os.write(near, b"\x00\xffhello\r\n\x11\x13")
    await until(lambda: heard.data == b"\x00\xffhello\r\n\x11\x13")
    line.write(b"\n\r\x04")
    assert os.read(near, 10) == b"\n\r\x04"
    await line.close()
    assert heard.lost == [None]
    with pytest.raises(DisconnectedError, match="is closed: open it first"):
        line.write(b"x")


async def test_a_port_belongs_to_one_and_can_be_opened_once_it_is_closed(pty: tuple[int, str]) -> None:
    path = pty[1]
    line = await connect(path, 1_000_000, Heard())
    with pytest.raises(
        DisconnectedError, match=rf"{path} is in use by .*\(process {os.getpid()}\).*: end that first"
    ):
        await connect(path, 1_000_000, Heard())
    await line.close()
    await (await connect(path, 1_000_000, Heard())).close()


async def test_a_port_that_goes_away_is_told_once(pty: tuple[int, str]) -> None:
    near, path = pty
    heard = Heard()
    line = await connect(path, 1_000_000, heard)
    os.close(near)
    await until(lambda: heard.lost)
    assert "has gone" in str(heard.lost[0])
    await line.close()
    await line.close()
    assert len(heard.lost) == 1


async def test_a_line_that_takes_no_bytes_is_given_up_and_closes_without_waiting(pty: tuple[int, str]) -> None:
    heard = Heard()
    line = await connect(pty[1], 1_000_000, heard)
    with pytest.raises(DisconnectedError, match="takes no more bytes"):
        [line.write(bytes(1000)) for _ in range(1000)]
    async with asyncio.timeout(2):
        await line.close()
    assert "takes no more bytes" in str(heard.lost[0])


async def test_an_odd_baud_rate_is_set_and_one_of_nothing_refused(pty: tuple[int, str]) -> None:
    await (await connect(pty[1], 4_500_000, Heard())).close()


async def test_who_stops_waiting_for_a_port_leaves_it_closed(pty: tuple[int, str]) -> None:
    opening = asyncio.ensure_future(connect(pty[1], 1_000_000, Heard()))
    await asyncio.sleep(0)
    opening.cancel()
    await asyncio.wait({opening})
    async with asyncio.timeout(5):
        while True:
            try:
                line = await connect(pty[1], 1_000_000, Heard())
                break
            except DisconnectedError:
                await asyncio.sleep(0.001)
    await line.close()


def ports(*found: tuple[str, int | None, int, str | None]) -> list[SimpleNamespace]:
    return [
        SimpleNamespace(device=path, vid=vid, pid=pid, serial_number=number) for path, vid, pid, number in found
    ]


TWO = ports(
    ("/dev/ttyUSB0", 0x0403, 0x6014, "FT1"), ("/dev/ttyACM0", 0x2341, 0x0042, "A1"), ("/dev/ttyS0", None, 0, None)
)


@pytest.mark.parametrize(
    ("name", "path"),
    [("0403:6014", "/dev/ttyUSB0"), ("2341:0042", "/dev/ttyACM0"), ("FT1", "/dev/ttyUSB0"), ("./arm", "./arm")],
)
def test_a_port_is_found_by_what_it_is(name: str, path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_line, "comports", lambda: TWO)
    assert find_port(name) == path


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("auto", r"several ports fit 'auto': /dev/ttyUSB0 \(0403:6014, serial number FT1\); /dev/ttyACM0"),
        ("FT9", r"no port fits 'FT9'; there is /dev/ttyUSB0 .* Plug it in, or give its path"),
    ],
)
def test_a_port_that_is_not_clear_is_told(name: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_line, "comports", lambda: TWO)
    with pytest.raises(DisconnectedError, match=said):
        find_port(name)


def test_the_only_usb_port_is_found_automatically(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_line, "comports", lambda: TWO[1:])
    assert find_port("auto") == "/dev/ttyACM0"
    monkeypatch.setattr(serial_line, "comports", list)
    with pytest.raises(DisconnectedError, match="there is no USB port at all"):
        find_port("auto")


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (serial.SerialException(errno.ENOENT, "x"), "there is no port /dev/null: plug its adapter in"),
        (PermissionError(errno.EACCES, "x"), r"run `sudo usermod -aG root \$USER` and log in again"),
        (serial.SerialException(errno.EAGAIN, "x"), "is in use by"),
        (termios.error(errno.EIO, "x"), r"has gone .*: plug its adapter in again"),
        (OSError(errno.ENXIO, "x"), "has gone"),
    ],
)
def test_every_error_of_a_port_has_its_cure(error: Exception, said: str) -> None:
    assert isinstance(explained("/dev/null", error), DisconnectedError)
    with pytest.raises(DisconnectedError, match=said):
        raise explained("/dev/null", error)


async def test_a_port_that_is_not_there_is_told() -> None:
    with pytest.raises(DisconnectedError, match="there is no port /dev/nothing-at-all"):
        await connect("/dev/nothing-at-all", 1_000_000, Heard())


def test_who_holds_a_port_is_found(pty: tuple[int, str]) -> None:
    assert [each for each in holders(pty[1]) if each.endswith(f"(process {os.getpid()})")]


def test_a_link_keeps_its_name(tmp_path: Path, pty: tuple[int, str]) -> None:
    link = tmp_path / "arm"
    link.symlink_to(pty[1])
    assert stable_name(str(link)) == str(link)
