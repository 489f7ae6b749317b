"""Tracks of a trace: each is a thread of a process, by the names that are shown, and numbers for the format."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from rtagent.schedule import REACTIVE

AGENT, WORLD, REACTIONS = "agent", "world", "reactions"
EPISODES, STIMULI, ELSEWHERE = "episodes", "stimuli", "learn, beside the loop"
LANE = "reactions"


class Track(NamedTuple):
    """A row of the picture."""

    process: str
    name: str


FIRST = [
    Track(AGENT, EPISODES),
    *(Track(AGENT, component.value) for component in REACTIVE),
    Track(AGENT, ELSEWHERE),
    Track(WORLD, STIMULI),
]
"""The order of the tracks that most runs have; others follow as they come."""


class Tracks:
    """Numbers tracks from 1, and tells the names of those that are used."""

    def __init__(self) -> None:
        self._processes = {AGENT: 1, WORLD: 2, REACTIONS: 3}
        self._threads = {track: number for number, track in enumerate(FIRST, 1)}
        self._used: dict[Track, None] = {}

    def numbers(self, track: Track) -> tuple[int, int]:
        """Return the numbers of a track's process and thread."""
        self._used[track] = None
        return self._processes[track.process], self._threads.setdefault(track, len(self._threads) + 1)

    def names(self) -> Iterator[dict[str, Any]]:
        """Yield the events that name all that was used, and put it in order."""
        for name in dict.fromkeys(track.process for track in self._used):
            number = self._processes[name]
            yield _metadata("process_name", number, 0, name=name)
            yield _metadata("process_sort_index", number, 0, sort_index=number)
        for track in self._used:
            process, thread = self.numbers(track)
            yield _metadata("thread_name", process, thread, name=track.name)
            yield _metadata("thread_sort_index", process, thread, sort_index=thread)


def _metadata(what: str, process: int, thread: int, **args: Any) -> dict[str, Any]:
    return {"name": what, "ph": "M", "pid": process, "tid": thread, "ts": 0, "args": args}


class Lanes:
    """Tracks for what may overlap: each takes the first lane that is free."""

    def __init__(self) -> None:
        self._free_at: list[int] = []

    def take(self, start: int, end: int) -> Track:
        """Return a track that is free from `start` to `end` (ns); starts must not go back."""
        free = next((lane for lane, until in enumerate(self._free_at) if until <= start), len(self._free_at))
        self._free_at[free:] = [end, *self._free_at[free + 1 :]]
        return Track(REACTIONS, f"{LANE} {free + 1}" if free else LANE)
