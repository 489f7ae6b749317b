"""Serial lines on the event loop: found by name, opened for oneself alone, closed without waiting for anybody.

Whatever goes wrong with a port is told as `DisconnectedError`, with its cure.
"""

from __future__ import annotations

import asyncio
import errno
import grp
import os
import re
import termios
from collections.abc import Awaitable, Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import serial
import serial_asyncio
from serial.tools.list_ports import comports

from rtagent.errors import DisconnectedError, SpecError

MOST_WAITING = 4096
"""Bytes that may wait to be sent: a line that takes no more is as good as gone."""

USB_ID = re.compile(r"([0-9a-fA-F]{4}):([0-9a-fA-F]{4})")
PORT_ERRORS = (serial.SerialException, OSError, termios.error)
"""What pyserial raises where a port cannot be opened, or has gone: `termios.error` is no OSError."""


class Receiver(Protocol):
    """What hears of a line."""

    def data_received(self, data: bytes, /) -> None:
        """Take bytes as they come."""

    def connection_lost(self, error: DisconnectedError | None, /) -> None:
        """Hear that the line has gone (with an error), or was closed."""


class Line(Protocol):
    """A serial line, or what stands for one, such as a socket to a terminal server."""

    path: str
    """The port that it was found at."""

    def write(self, data: bytes, /) -> None:
        """Send `data`, at once as far as the system takes it; raise `DisconnectedError`. Never waits."""

    async def close(self) -> None:
        """Drop what was not sent, and return when the port is closed: only then can it be opened again."""


Connect = Callable[[str, int, Receiver], Awaitable[Line]]
"""What opens a line: see `connect`."""


async def connect(port: str, baud: int, receiver: Receiver) -> Line:
    """Open `port` at `baud` bits a second and hand what comes to `receiver`.

    `port` is a path, a USB id ("0403:6014"), a serial number, or "auto" for the only USB port. Raises
    `DisconnectedError` where there is none, where it is not allowed, or where another program holds it.
    """
    loop = asyncio.get_running_loop()
    opening = loop.run_in_executor(None, _open, port, baud)  # USB adapters take some milliseconds to open
    try:
        opened = await asyncio.shield(opening)
    except asyncio.CancelledError:
        opening.add_done_callback(_discard)
        raise
    return SerialLine(opened, receiver, loop)


class SerialLine:
    """A port of this machine: pyserial opens it, pyserial-asyncio reads it."""

    def __init__(self, port: _Port, receiver: Receiver, loop: asyncio.AbstractEventLoop) -> None:
        self.path = str(port.port)
        self._receiver = receiver
        self._fd: int = port.fileno()
        self._closed: asyncio.Future[None] = loop.create_future()
        port.when_closed = self._note_closed
        self._error: DisconnectedError | None = None
        self._transport = serial_asyncio.SerialTransport(loop, _Relay(self, receiver), port)

    def write(self, data: bytes, /) -> None:
        """Send `data` now; what the system does not take follows by itself."""
        if self._closed.done() or self._transport.is_closing():
            raise DisconnectedError(f"{self.path} is closed: open it first.")
        waiting = self._transport.get_write_buffer_size()
        if waiting > MOST_WAITING:
            raise self._give_up(DisconnectedError(f"{self.path} takes no more bytes: plug its adapter in anew."))
        sent = 0 if waiting else self._write_now(data)
        if sent < len(data):
            self._transport.write(data[sent:])

    async def close(self) -> None:
        """Close the port, and return when it is closed."""
        if not self._transport.is_closing():
            self._transport.abort()
        await asyncio.shield(self._closed)

    def lost(self, error: Exception | None) -> None:
        """Tell the receiver that the line is gone."""
        if error is not None and self._error is None:
            self._error = explained(self.path, error)
        self._receiver.connection_lost(self._error)

    def _write_now(self, data: bytes) -> int:
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise self._give_up(explained(self.path, error)) from error

    def _give_up(self, error: DisconnectedError) -> DisconnectedError:
        self._error = error
        self._transport.abort()
        return error

    def _note_closed(self) -> None:
        if not self._closed.done():
            self._closed.set_result(None)


class _Relay(asyncio.Protocol):
    """Between transport and receiver; bytes go straight through."""

    def __init__(self, line: SerialLine, receiver: Receiver) -> None:
        self._line = line
        self.data_received = receiver.data_received  # type: ignore[assignment,method-assign]  # no call in between

    def connection_lost(self, error: Exception | None) -> None:
        self._line.lost(error)


class _Port(serial.Serial):  # type: ignore[misc]  # pyserial has no types
    """A port for a loop that knows when there is something to read, and that nothing may block."""

    when_closed: Callable[[], None] | None = None

    def read(self, size: int = 1) -> bytes:
        """Return what is there, without asking the system first whether there is."""
        try:
            data = os.read(self.fd, size)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise serial.SerialException(error.errno, str(error)) from error
        if not data:
            raise serial.SerialException("it was hung up")
        return data

    def flush(self) -> None:
        """Drop what was not sent, in place of waiting for it."""
        termios.tcflush(self.fd, termios.TCOFLUSH)

    def close(self) -> None:
        """Close the port, and say so."""
        super().close()
        if self.when_closed is not None:
            self.when_closed()


def _open(port: str, baud: int) -> _Port:
    path = find_port(port)
    try:
        # without inter_byte_timeout nothing-yet reads like hung-up: VMIN would be 0
        return _Port(path, baud, timeout=0, inter_byte_timeout=0, exclusive=True)
    except ValueError as error:
        raise SpecError(f"{path} cannot run at {baud} baud ({error}): use a rate that its adapter has.") from error
    except PORT_ERRORS as error:
        raise explained(path, error) from error


def _discard(opening: asyncio.Future[_Port]) -> None:
    """Close a port that came when nobody waited for it any more."""
    if not opening.cancelled() and opening.exception() is None:
        opening.result().close()


def find_port(port: str) -> str:
    """Return the path of a port by its path, USB id, serial number, or "auto"; raise `DisconnectedError`."""
    if "/" in port:
        return port
    usb = [each for each in comports() if each.vid is not None]
    fitting = [each for each in usb if _fits(each, port)]
    if len(fitting) == 1:
        return str(fitting[0].device)
    there = "; ".join(_described(each) for each in fitting or usb) or "no USB port at all"
    if fitting:
        raise DisconnectedError(f"several ports fit {port!r}: {there}. Name one by its serial number or its path.")
    raise DisconnectedError(f"no port fits {port!r}; there is {there}. Plug it in, or give its path.")


def stable_name(path: str) -> str:
    """Return the name of a port that stays the same when it is plugged in anew, where it has one."""
    real = os.path.realpath(path)
    links = sorted(Path("/dev/serial/by-id").glob("*"))
    named = next((str(link) for link in links if os.path.realpath(link) == real), None)
    return named or os.path.abspath(path)  # noqa: PTH100  # a link is to stay one, not to be resolved


def _fits(port: Any, name: str) -> bool:
    usb_id = USB_ID.fullmatch(name)
    if usb_id is not None:
        return (port.vid, port.pid) == (int(usb_id[1], 16), int(usb_id[2], 16))
    return name == "auto" or name == port.serial_number


def _described(port: Any) -> str:
    number = f", serial number {port.serial_number}" if port.serial_number else ""
    return f"{port.device} ({port.vid:04x}:{port.pid:04x}{number})"


def explained(path: str, error: Exception) -> DisconnectedError:
    """Return what an error of a port means, with its cure."""
    if isinstance(error, DisconnectedError):
        return error
    number = error.args[0] if error.args and isinstance(error.args[0], int) else getattr(error, "errno", None)
    if number == errno.ENOENT:
        return DisconnectedError(f"there is no port {path}: plug its adapter in, or look with `rtagent devices`.")
    if number in (errno.EACCES, errno.EPERM):
        return DisconnectedError(
            f"you may not open {path}: run `sudo usermod -aG {group_of(path)} $USER` and log in again."
        )
    if number in (errno.EAGAIN, errno.EBUSY):
        held = " and ".join(holders(path)) or "another program"
        return DisconnectedError(f"{path} is in use by {held}: end that first.")
    return DisconnectedError(f"{path} has gone ({error}): plug its adapter in again.")


def group_of(path: str) -> str:
    """Return the name of the group that may open `path`, such as dialout."""
    try:
        return grp.getgrgid(Path(path).stat().st_gid).gr_name
    except (OSError, KeyError):
        return "dialout"


def holders(path: str) -> Sequence[str]:
    """Return who has `path` open, as far as this user may know: "python3 (process 4711)"."""
    real = os.path.realpath(path)
    return [
        f"{_name(process)} (process {process.name})"
        for process in Path("/proc").glob("[0-9]*")
        if real in _open_files(process)
    ]


def _open_files(process: Path) -> Iterator[str]:
    try:
        for file in (process / "fd").iterdir():
            yield str(file.readlink())
    except OSError:  # it has ended, or is somebody else's
        return


def _name(process: Path) -> str:
    try:
        return (process / "comm").read_text().strip()
    except OSError:
        return "a program"


def latency_timer(path: str) -> int | None:
    """Return the latency timer of a USB adapter in ms, or None where the port has none (a pty, a UART)."""
    name = Path(os.path.realpath(path)).name
    try:
        return int(Path(f"/sys/bus/usb-serial/devices/{name}/latency_timer").read_text())
    except (OSError, ValueError):
        return None
