"""The optional back end `sdk`: the servos' own library talks to them, in a process of its own, because it spins.

To a bus it is a line: the requests that are written to it go to that process, which asks the dynamixel-sdk, and the
answers come back as the bytes that a true line would have brought. What the SDK does wrong stays wrong: it sends
FF FF FD in parameters of protocol 2.0 unstuffed, and gives up a group read at the first servo that is silent.
"""

from __future__ import annotations

import asyncio
import json
import sys
from functools import partial
from importlib.util import find_spec

from rtagent.errors import DisconnectedError, SpecError
from rtagent.units import second
from rtagent_drivers.dynamixel.bus import Bus
from rtagent_drivers.dynamixel.packets import Codec
from rtagent_drivers.serial_line import Line, Receiver, find_port

MODULE = "rtagent_drivers.dynamixel.sdk_process"
STARTING, ENDING = 20 * second, 1 * second
"""How long (ns) the process may take to open the port, and to end once nobody needs it."""

STDIN, STDOUT = 0, 1


def sdk_bus(codec: Codec, port: str, baud: int) -> Bus:
    """Return a bus whose requests the dynamixel-sdk sends; raise `SpecError` where that is not installed."""
    if find_spec("dynamixel_sdk") is None:
        raise SpecError('backend is "sdk", but the dynamixel-sdk is not there: pip install "rtagent[sdk]".')
    return Bus(codec, port, baud, connect=partial(connect, codec.protocol))


async def connect(protocol: int, port: str, baud: int, receiver: Receiver) -> Line:
    """Start the process, which opens `port` (see `serial_line.find_port`) at `baud` (bit/s).

    Raises `DisconnectedError` where it cannot.
    """
    path = find_port(port)
    command = [sys.executable, "-m", MODULE, path, str(baud), str(protocol)]
    loop = asyncio.get_running_loop()
    transport, line = await loop.subprocess_exec(
        lambda: SdkLine(path, receiver, loop),
        *command,
        stderr=None,
        start_new_session=True,  # a Ctrl-C is for us: what makes the arm safe still needs this process
    )
    line.started(transport)
    try:
        async with asyncio.timeout(STARTING / second):
            await line.ready
    except BaseException as error:
        await line.close()
        if isinstance(error, TimeoutError):
            raise DisconnectedError(f"the SDK's process does not open {path}: look what holds it up.") from error
        raise
    return line


class SdkLine(asyncio.SubprocessProtocol):
    """The pipes to the process."""

    def __init__(self, path: str, receiver: Receiver, loop: asyncio.AbstractEventLoop) -> None:
        self.path = path
        self.ready: asyncio.Future[None] = loop.create_future()
        self._receiver = receiver
        self._ended: asyncio.Future[None] = loop.create_future()
        self._greeting = b""
        self._closing = False

    def started(self, transport: asyncio.SubprocessTransport) -> None:
        """Take the way to the process."""
        self._transport = transport
        self._requests = transport.get_pipe_transport(STDIN)

    def write(self, data: bytes, /) -> None:
        """Send requests, at once as far as the pipe takes them; raise `DisconnectedError`."""
        if self._closing or self._ended.done():
            raise DisconnectedError(f"{self.path} is closed: open it first.")
        assert isinstance(self._requests, asyncio.WriteTransport)
        self._requests.write(data)

    async def close(self) -> None:
        """Let the process end, and return when it has: only then can the port be opened again."""
        self._closing = True
        if self._requests is not None:
            self._requests.close()
        try:
            async with asyncio.timeout(ENDING / second):
                await asyncio.shield(self._ended)
        except TimeoutError:
            self._transport.kill()
            await self._ended
        self._transport.close()

    def pipe_data_received(self, fd: int, data: bytes) -> None:
        """Take what the process says: one line first, and then answers."""
        if self.ready.done():
            self._receiver.data_received(data)
            return
        self._greeting += data
        first, newline, rest = self._greeting.partition(b"\n")
        if newline:
            self._greet(json.loads(first))
            if rest:
                self._receiver.data_received(rest)

    def process_exited(self) -> None:
        """Note the end of the process: the port was lost, or is no longer needed."""
        self._ended.set_result(None)
        error = DisconnectedError(f"{self.path} has gone, or the SDK's process ended: plug its adapter in again.")
        if not self.ready.done():
            self.ready.set_exception(error)
        elif not self._closing:
            self._receiver.connection_lost(error)

    def _greet(self, said: str) -> None:
        if said:
            self.ready.set_exception(DisconnectedError(said))
        else:
            self.ready.set_result(None)
