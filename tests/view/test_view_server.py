"""The view's server: to whom it answers, and that a slow page is sent less."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from view_records import seen_run, take
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

import rtagent.view
from rtagent.telemetry.connection import Access, TelemetryError
from rtagent.units import ms
from rtagent.view.commands import asking
from rtagent.view.frames import decoded
from rtagent.view.runs import Runs
from rtagent.view.server import Page

PAGE = Path(rtagent.view.__file__).parent / "page"


async def refuses(run: str, name: str, text: str) -> str:
    raise TelemetryError(f"{run} takes no {name}: {text}.")


@asynccontextmanager
async def page() -> AsyncIterator[tuple[Runs, int]]:
    runs = Runs()
    async with Page(runs, refuses).serving(0) as port:
        yield runs, port


def talk(port: int, **settings: object) -> connect:
    return connect(f"ws://127.0.0.1:{port}/stream", **({"origin": f"http://127.0.0.1:{port}"} | settings))  # type: ignore[arg-type]


async def get(port: int, path: str, *headers: str) -> tuple[int, dict[str, str], bytes]:
    """Ask as any program could, byte by byte."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    given = headers if any(each.startswith("Host") for each in headers) else (f"Host: 127.0.0.1:{port}", *headers)
    writer.write(("\r\n".join([f"GET {path} HTTP/1.1", *given]) + "\r\n\r\n").encode())
    head, _, body = (await reader.read()).partition(b"\r\n\r\n")
    writer.close()
    first, *lines = head.decode().split("\r\n")
    return int(first.split()[1]), dict(line.split(": ", 1) for line in lines), body


async def test_the_page_and_all_that_it_needs_come_from_here() -> None:
    async with page() as (_, port):
        status, headers, body = await get(port, "/")
        assert status == 200
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        for name in re.findall(rb'(?:src|href)="([^#"]+)"', body):
            assert (await get(port, f"/{name.decode()}"))[0] == 200
    sources = [path.read_text() for path in PAGE.rglob("*") if path.suffix in (".js", ".html", ".css")]
    for source in sources:
        assert not re.search(r"(?:src|href)=[\"']?https?:|import .*https?:|@import|url\(http", source)
    assert "MIT" in (PAGE / "uplot" / "LICENSE").read_text()


@pytest.mark.parametrize("path", ["/none", "/../server.py", "/%2e%2e/server.py", "//etc/passwd", "/uplot/"])
async def test_nothing_else_is_served(path: str) -> None:
    async with page() as (_, port):
        assert (await get(port, path))[0] == 404


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "localhost:1", "127.0.0.1.evil.example:{port}"])
async def test_another_name_for_this_machine_is_refused(host: str) -> None:
    async with page() as (_, port):
        status, _, said = await get(port, "/", f"Host: {host.format(port=port)}")
        assert status == 403
        assert b"under no other name" in said


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", None, "https://127.0.0.1:{port}", "http://127.0.0.1:1"]
)
async def test_a_page_from_another_origin_gets_no_stream(origin: str | None) -> None:
    async with page() as (_, port):
        with pytest.raises(InvalidStatus, match="403"):
            async with talk(port, origin=origin.format(port=port) if origin else None):
                pass
        if origin:
            assert (await get(port, "/main.js", f"Origin: {origin.format(port=port)}"))[0] == 403


async def test_it_listens_on_the_loopback_interface_alone() -> None:
    async with page() as (_, port):
        with pytest.raises(OSError):  # noqa: PT011  # whichever the system says
            await asyncio.open_connection("127.0.0.2", port)


async def ask(connection: ClientConnection, **wish: object) -> None:
    await connection.send(json.dumps({"wish": wish}))


async def test_a_page_that_does_not_ask_is_sent_nothing_however_much_comes() -> None:
    async with page() as (runs, port), talk(port) as connection:
        runs.seen["arm/1"] = run = seen_run()
        for number in range(3000):
            take(run, "sample", number, time=number * ms)
            runs.tell_news()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(connection.recv(), 0.1)
        await ask(connection, series=["sample/joint/x"], columns=50)
        frame = await asyncio.wait_for(connection.recv(), 5)
        assert isinstance(frame, bytes)
        head, _ = decoded(frame)
        assert head["newest"] == pytest.approx(2.999)
        assert len(frame) < 4000


async def test_the_same_wish_is_answered_when_there_is_something_new() -> None:
    async with page() as (runs, port), talk(port) as connection:
        runs.seen["arm/1"] = run = seen_run()
        for _ in range(2):
            await ask(connection)
        await asyncio.wait_for(connection.recv(), 5)
        second = asyncio.ensure_future(connection.recv())
        await asyncio.wait({second}, timeout=0.1)
        assert not second.done()
        take(run, "sample", 0, time=5 * ms)
        runs.tell_news()
        head, _ = decoded(await asyncio.wait_for(second, 0.3))  # type: ignore[arg-type]  # frames are bytes
        assert head["newest"] == pytest.approx(0.005)


@pytest.mark.parametrize(
    "message", ["", "[]", '{"wish": {"columns": 100000}}', '{"wish": {"span": -1}}', '{"wish": 3}']
)
async def test_a_wish_that_cannot_be_is_refused(message: str) -> None:
    async with page() as (_, port), talk(port) as connection:
        await connection.send(message)
        with pytest.raises(ConnectionClosed) as closed:
            await connection.recv()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008


async def test_what_became_of_a_command_is_told() -> None:
    async with page() as (_, port), talk(port) as connection:
        await connection.send(json.dumps({"command": "stop", "run": "arm/1", "text": "why"}))
        assert json.loads(await connection.recv()) == {
            "command": "stop", "done": False, "said": "arm/1 takes no stop: why.",
        }  # fmt: skip


@pytest.mark.parametrize(
    ("run", "name"), [("arm/1", "delete"), ("arm/*", "stop"), ("arm", "stop"), ("a/b/c", "stop")]
)
async def test_a_command_goes_to_one_run_and_is_one_of_three(run: str, name: str) -> None:
    with pytest.raises(TelemetryError, match="give stop, annotate or press"):
        await asking(Access())(run, name, "")
