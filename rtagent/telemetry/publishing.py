"""A run on Zenoh: its records, the newest of them for late joiners, their schemas, and the keys of control."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rtagent.telemetry.connection import Access, TelemetryError, open_client, reason, zenoh_module
from rtagent.telemetry.keys import Place
from rtagent.telemetry.records import STREAMS, schema_name, schemas

LOOK_EVERY = 1.0
"""So often (s) it is seen whether there is still a router."""

SETTLING = 0.05
"""So long (s) it may take until the router has told who listens."""

Control = Callable[[str, str], str]
"""Takes a command and its text; returns what was done, or raises `TelemetryError`."""


class Publisher:
    """Publishes encoded records once a session is there, which `start` opens in a thread of its own.

    What comes before that, or while the router is away, is not published; the newest of each stream is kept.
    `trouble` is told, once, why there is no session.
    """

    def __init__(
        self, access: Access, place: Place, control: Control | None, trouble: Callable[[str], None]
    ) -> None:
        self._access, self._place, self._control, self._trouble = access, place, control, trouble
        self._newest: dict[str, bytes] = {}
        self._publishers: dict[str, Any] = {}
        self._session: Any = None
        self._token: Any = None
        self._ending, self._tried = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._keep, name="zenoh", daemon=True)

    def start(self, patience: float) -> None:
        """Begin to open a session, and wait `patience` (s) for it, so that who listens already misses nothing."""
        self._thread.start()
        self._tried.wait(patience)

    def put(self, stream: str, data: bytes) -> None:
        """Publish a record; never waits for anybody."""
        self._newest[stream] = data
        publisher = self._publishers.get(stream)
        if publisher is not None:
            with suppress(Exception):  # the session is being closed, or the router has gone
                publisher.put(data)

    def close(self, timeout: float) -> None:
        """Close the session, within `timeout` (s)."""
        self._ending.set()
        self._thread.join(timeout)

    def _keep(self) -> None:
        """Keep a session open, with a router to connect to, until the end."""
        told = False
        while not self._ending.is_set():
            try:
                with open_client(self._access) as self._session:
                    self._declare(self._session)
                    self._ending.wait(SETTLING)
                    self._tried.set()
                    self._watch()
                    self._publishers = {}
            except Exception as error:  # whatever Zenoh raises: the run and its recording go on
                if not told:
                    said = str(error) if isinstance(error, TelemetryError) else f"Zenoh says: {reason(error)}"
                    self._trouble(f"nothing is published: {said}")
                told = True
                self._tried.set()
                self._ending.wait(LOOK_EVERY)

    def _watch(self) -> None:
        """Return when the router has gone, or at the end."""
        while not self._ending.wait(LOOK_EVERY):
            if not list(self._session.info.transports()):
                return

    def _declare(self, session: Any) -> None:
        zenoh, place = zenoh_module(), self._place
        session.declare_queryable(place.key("*"), self._answer_newest)
        session.declare_queryable(place.schema("*"), self._answer_schemas)
        if self._control is not None:
            session.declare_queryable(place.control("*"), self._answer_control)
        self._publishers = {
            stream: session.declare_publisher(
                place.key(stream),
                encoding=zenoh.Encoding.APPLICATION_JSON.with_schema(schema_name(stream)),
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for stream in STREAMS
        }
        if "run" in self._newest:  # those who watched before the run began have not heard of it
            self._publishers["run"].put(self._newest["run"])
        self._token = session.liveliness().declare_token(place.run)  # ends where nobody holds it

    def _answer_newest(self, query: Any) -> None:
        encoding = zenoh_module().Encoding.APPLICATION_JSON
        for stream, data in list(self._newest.items()):
            self._reply(query, self._place.key(stream), data, encoding.with_schema(schema_name(stream)))

    def _answer_schemas(self, query: Any) -> None:
        encoding = zenoh_module().Encoding.APPLICATION_JSON.with_schema("json-schema")
        for stream, data in schemas():
            self._reply(query, self._place.schema(stream), data, encoding)

    def _reply(self, query: Any, key: str, data: bytes, encoding: Any) -> None:
        if query.key_expr.intersects(zenoh_module().KeyExpr(key)):
            query.reply(key, data, encoding=encoding)

    def _answer_control(self, query: Any) -> None:
        command = str(query.key_expr).rsplit("/", 1)[1]
        text = query.payload.to_string() if query.payload is not None else ""
        try:
            query.reply(self._place.control(command), self._control(command, text))  # type: ignore[misc]  # declared
        except TelemetryError as error:
            query.reply_err(str(error))
