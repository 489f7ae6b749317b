r"""Presses as messages: lines of JSON over TCP or a Unix socket.

    {"event": "press"}                      {"event": "release", "time": 81234567890123}

`time` (ns) is the sender's monotonic clock, of use where it is on this machine. A line that is none of these is
counted, answered by {"error": "…"}, and changes nothing. A sender that goes away lets go of the button. Where
credentials are asked for, a connection's first line is {"token": "…"}.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import ipaddress
import json
import os
import socket
import stat
from pathlib import Path
from typing import Any

from rtagent.errors import DisconnectedError, SpecError
from rtagent_drivers.button.sources import Hearing

LONGEST_LINE = 512
MOST_CONNECTIONS = 8
MOST_ANSWERS = 4096
"""Bytes of answers that may wait for somebody who does not read them; then there are no more."""

SHORTEST_TOKEN = 16
EVENTS = {"press": True, "release": False}


class Listener:
    """Connections of one socket. The button is pressed while any of them says so."""

    def __init__(self, hearing: Hearing, token: str) -> None:
        self.hearing, self.token = hearing, token
        self.connections: set[Connection] = set()
        self._pressing: set[Connection] = set()

    def set(self, connection: Connection, pressed: bool, sent_at: int | None) -> None:
        """Hear of what one of them says."""
        (self._pressing.add if pressed else self._pressing.discard)(connection)
        if bool(self._pressing) == pressed:
            self.hearing.hear(pressed, sent_at)

    def gone(self, connection: Connection) -> None:
        """Hear that one of them has gone: it lets go."""
        self.connections.discard(connection)
        if connection in self._pressing:
            self.set(connection, pressed=False, sent_at=None)


class Connection(asyncio.Protocol):
    """One that sends lines."""

    def __init__(self, listener: Listener) -> None:
        self._listener, self._rest = listener, b""
        self._trusted = not listener.token

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take it, unless there are too many."""
        self._transport: Any = transport
        if len(self._listener.connections) >= MOST_CONNECTIONS:
            self._refuse(f"there are {MOST_CONNECTIONS} connections already", "connections_refused")
            self._transport.close()
            return
        self._listener.connections.add(self)

    def data_received(self, data: bytes) -> None:
        """Take whole lines; a line that is too long ends the connection."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if self._transport.is_closing():
                return
            self._take(line)
        if len(self._rest) > LONGEST_LINE:
            self._refuse(f"a line is longer than {LONGEST_LINE} bytes", "lines_refused")
            self._transport.close()

    def connection_lost(self, error: Exception | None) -> None:
        """Let go of the button."""
        if self._rest:
            self._listener.hearing.counters["lines_refused"] += 1  # one that was cut short
        self._listener.gone(self)

    def close(self) -> None:
        """End it."""
        self._transport.abort()

    def _take(self, line: bytes) -> None:
        try:
            message = json.loads(line) if len(line) <= LONGEST_LINE else None
        except (ValueError, RecursionError):
            message = None
        if not self._trusted:
            self._check(message)
            return
        problem = _problem(message)
        if problem:
            self._refuse(problem, "lines_refused")
        elif isinstance(message, dict):
            self._listener.set(self, EVENTS[message["event"]], message.get("time"))

    def _check(self, message: object) -> None:
        given = message.get("token") if isinstance(message, dict) else None
        expected = self._listener.token.encode()
        self._trusted = isinstance(given, str) and hmac.compare_digest(given.encode(), expected)
        if not self._trusted:
            self._refuse("the first line is not the token", "connections_refused")
            self._transport.close()

    def _refuse(self, problem: str, counted: str) -> None:
        self._listener.hearing.counters[counted] += 1
        if self._transport.get_write_buffer_size() < MOST_ANSWERS:
            self._transport.write(json.dumps({"error": problem}).encode() + b"\n")


def _problem(message: object) -> str:
    """Say what is wrong with a message, or nothing."""
    if not isinstance(message, dict):
        return f"a line is a JSON object of at most {LONGEST_LINE} bytes"
    if not isinstance(message.get("event"), str) or message["event"] not in EVENTS:
        return 'event is "press" or "release"'
    if isinstance(message.get("time"), bool) or not isinstance(message.get("time", 0), int):
        return "time is a whole number of nanoseconds"
    unknown = sorted(message.keys() - {"event", "time"})
    return f"there is no {unknown[0]!r}: give event and time" if unknown else ""


class TCPSource:
    """Messages over TCP. Beyond the loopback interface only with a token, which is in a file of one's own.

    Raises `SpecError` where that is not so.
    """

    def __init__(self, host: str, port: int, token_file: str) -> None:
        if not 1 <= port <= 65535:
            raise SpecError('the source "tcp" needs a port from 1 to 65535.')
        self._host, self._port = host, port
        self._token = _token(token_file) if token_file else ""
        if not self._token and not _is_loopback(host):
            raise SpecError(
                f"a button at {host} could be pressed by anybody who reaches it: give token_file, a file that "
                f"holds a token of {SHORTEST_TOKEN} characters or more, or host 127.0.0.1."
            )
        self._server: asyncio.Server | None = None

    async def open(self, hearing: Hearing) -> None:
        """Listen; raise `DisconnectedError` where the port is not to be had."""
        self._listener = Listener(hearing, self._token)
        loop = asyncio.get_running_loop()
        try:
            self._server = await loop.create_server(lambda: Connection(self._listener), self._host, self._port)
        except OSError as error:
            raise DisconnectedError(
                f"port {self._port} of {self._host} is not to be had ({error.strerror or error}): take another."
            ) from error

    async def close(self) -> None:
        """Stop listening, and end all connections."""
        server, self._server = self._server, None
        if server is not None:
            _end(server, self._listener)


class UnixSource:
    """Messages over a Unix socket, which only this user can open. Raises `SpecError` without a path."""

    def __init__(self, path: str) -> None:
        if not path:
            raise SpecError('the source "unix" needs a path, such as path = "/tmp/button".')
        self._path = path
        self._server: asyncio.Server | None = None

    async def open(self, hearing: Hearing) -> None:
        """Listen; raise `DisconnectedError` where something else is at the path."""
        self._listener = Listener(hearing, "")
        listening = _bound(self._path)
        loop = asyncio.get_running_loop()
        self._server = await loop.create_unix_server(lambda: Connection(self._listener), sock=listening)

    async def close(self) -> None:
        """Stop listening, end all connections, and remove the socket."""
        server, self._server = self._server, None
        if server is not None:
            _end(server, self._listener)
            with contextlib.suppress(OSError):
                os.unlink(self._path)  # noqa: PTH108  # as bind names it


def _end(server: asyncio.Server, listener: Listener) -> None:
    server.close()
    for connection in list(listener.connections):
        connection.close()


def _bound(path: str) -> socket.socket:
    """Return a socket at `path`, in place of one that nobody listens at any more."""
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    mask = os.umask(0o177)
    try:
        _remove_abandoned(path)
        listening.bind(path)
    except OSError as error:
        listening.close()
        raise DisconnectedError(
            f"no socket can be made at {path} ({error.strerror or error}): take another."
        ) from error
    finally:
        os.umask(mask)
    return listening


def _remove_abandoned(path: str) -> None:
    """Remove a socket that nobody listens at; what is no socket, or is used, stays."""
    try:
        if not stat.S_ISSOCK(os.lstat(path).st_mode):
            return
    except FileNotFoundError:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        try:
            asking.connect(path)
        except ConnectionRefusedError:
            os.unlink(path)  # noqa: PTH108  # as bind names it, links are not followed


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _token(path: str) -> str:
    try:
        token = Path(path).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeError) as error:
        raise SpecError(f"token_file {path} cannot be read ({error}).") from error
    if len(token) < SHORTEST_TOKEN:
        raise SpecError(f"the token in {path} is shorter than {SHORTEST_TOKEN} characters: make a longer one.")
    return token
