"""All runs that are seen, fed by what comes of them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator

from rtagent.telemetry.records import Run
from rtagent.telemetry.subscribe import Access, subscribe
from rtagent.view.seen import SeenRun

MOST_RUNS = 8
"""So many runs are kept: of others, the one of which nothing came for longest makes room."""


class Runs:
    """Runs by `agent/run`, in the order in which they were first heard of."""

    def __init__(self) -> None:
        self.seen: dict[str, SeenRun] = {}
        self._news: set[asyncio.Event] = set()

    async def feed(self, agent: str, access: Access) -> None:
        """Take what is published, for ever; raise `TelemetryError` where there is no connection."""
        async with contextlib.aclosing(subscribe(agent, access=access)) as messages:
            async for message in messages:
                name = f"{message.agent}/{message.run}"
                run = self.seen.get(name) or self._new(name)
                run.heard = asyncio.get_running_loop().time()
                run.take(message)
                self.tell_news()

    def tell_news(self) -> None:
        """Let everybody who waits for news have a look."""
        for news in self._news:
            news.set()

    @contextlib.contextmanager
    def news(self) -> Iterator[asyncio.Event]:
        """Give an event that is set whenever a record came."""
        event = asyncio.Event()
        self._news.add(event)
        try:
            yield event
        finally:
            self._news.discard(event)

    def chosen(self, name: str) -> str:
        """Return the name of the run that is asked for, or where there is none such, of the newest."""
        if name in self.seen or not self.seen:
            return name
        going_on = [each for each, run in self.seen.items() if not _ended(run.run)]
        return (going_on or list(self.seen))[-1]

    def told(self) -> list[dict[str, str]]:
        """Return what is said of each run where one can be chosen."""
        return [{"name": name, "state": run.watched.state()} for name, run in self.seen.items()]

    def _new(self, name: str) -> SeenRun:
        if len(self.seen) >= MOST_RUNS:
            del self.seen[min(self.seen, key=lambda each: self.seen[each].heard)]
        return self.seen.setdefault(name, SeenRun())


def _ended(run: Run | None) -> bool:
    return run is not None and bool(run.ended)
