"""Serves the page and its WebSocket, on the loopback interface alone, and to no other page."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from http import HTTPStatus
from importlib.resources import files
from urllib.parse import urlsplit

import msgspec
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from rtagent.errors import RtagentError
from rtagent.view.commands import Ask
from rtagent.view.frames import Frames, Wish
from rtagent.view.runs import Runs

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
STREAM = "/stream"
IDLE = 0.5
"""So often (s) a page is answered of which nothing is new."""

KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
SOURCES = ("script-src", "style-src", "img-src", "connect-src")
POLICY = "; ".join(["default-src 'none'", *(f"{each} 'self'" for each in SOURCES), "frame-ancestors 'none'"])
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


class Page:
    """The server of one `rtagent view`."""

    def __init__(self, runs: Runs, ask: Ask) -> None:
        self._runs, self._ask = runs, ask
        self._files = dict(_page_files())

    @contextlib.asynccontextmanager
    async def serving(self, port: int) -> AsyncIterator[int]:
        """Serve meanwhile; give the port, another one if `port` is 0. Raises `OSError` where it is taken."""
        async with serve(
            self._talk, HOST, port, process_request=self._answer, compression=None, max_size=1 << 16,
            server_header=None, close_timeout=1,
        ) as server:  # fmt: skip
            yield _port(server)

    # HTTP

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request, or let it become a WebSocket: None."""
        path = urlsplit(request.path).path
        if refused := refusal(request.headers, connection.local_address[1], needs_origin=path == STREAM):
            return response(HTTPStatus.FORBIDDEN, "text/plain", refused.encode())
        if path == STREAM:
            return None
        path = "/index.html" if path == "/" else path
        found = self._files.get(path)
        if found is None:
            return response(HTTPStatus.NOT_FOUND, "text/plain", b"There is no such file.")
        return response(HTTPStatus.OK, KINDS.get(path.rsplit(".", 1)[-1], "text/plain"), found)

    # WebSocket

    async def _talk(self, connection: ServerConnection) -> None:
        """Answer each wish with a frame once there is something new; a page that asks less often is sent less."""
        frames, asking = Frames(self._runs), set[asyncio.Task[None]]()
        with contextlib.suppress(ConnectionClosed), self._runs.news() as news:
            last = None
            async for message in connection:
                try:
                    asked = msgspec.json.decode(message, type=Asked)
                except msgspec.MsgspecError as error:
                    await connection.close(1008, str(error)[:100])
                    return
                if asked.command:
                    asking.add(task := asyncio.create_task(self._do(connection, asked)))
                    task.add_done_callback(asking.discard)
                if asked.wish is None:
                    continue
                if asked.wish == last:
                    await _either(news)
                news.clear()
                last = asked.wish
                await connection.send(frames(asked.wish, asyncio.get_running_loop().time()))

    async def _do(self, connection: ServerConnection, asked: Asked) -> None:
        """Pass a command on to the run, and tell the page what became of it."""
        try:
            said, done = await self._ask(asked.run, asked.command, asked.text), True
        except RtagentError as error:
            said, done = str(error), False
        with contextlib.suppress(ConnectionClosed):
            await connection.send(
                msgspec.json.encode({"command": asked.command, "done": done, "said": said}).decode()
            )


class Asked(msgspec.Struct, frozen=True):
    """A message of the page: a wish, or a command (stop, annotate or press) with its text for a run."""

    wish: Wish | None = None
    command: str = ""
    run: str = ""
    text: str = ""


def refusal(headers: Headers, port: int, *, needs_origin: bool) -> str:
    """Return why a request is refused, in a sentence, or "": it must name this server, and be its own page's."""
    own = {f"{name}:{port}" for name in NAMES}
    if headers.get_all("Host") not in [[each] for each in own]:
        return f"Ask for http://{HOST}:{port}: this page is served under no other name."
    origins = headers.get_all("Origin")
    if (origins or needs_origin) and origins not in [[f"http://{each}"] for each in own]:
        return "Only the page that is served here may ask."
    return ""


def response(status: HTTPStatus, kind: str, body: bytes) -> Response:
    """Return a response that lets no other page use it."""
    headers = Headers(HEADERS | {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body))})
    headers["Connection"] = "close"
    return Response(status.value, status.phrase, headers, body)


async def _either(news: asyncio.Event) -> None:
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(news.wait(), IDLE)


def _port(server: Server) -> int:
    return int(next(iter(server.sockets)).getsockname()[1])


def _page_files() -> list[tuple[str, bytes]]:
    page = files("rtagent.view") / "page"
    folders = [("", page), ("/uplot", page / "uplot")]
    return [
        (f"{name}/{each.name}", each.read_bytes())
        for name, folder in folders
        for each in folder.iterdir()
        if each.is_file()
    ]
