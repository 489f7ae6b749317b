"""What the page asks for, and the frames that it is answered with: never more than its plots can show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from rtagent.units import second
from rtagent.view.decimate import Grid, decimate, grid
from rtagent.view.returns import returns
from rtagent.view.runs import Runs
from rtagent.view.seen import SeenRun

MOST_COLUMNS = 2000
MOST_SERIES = 48
SLOW = 0.25
"""So often (s) tables and histograms are sent, which nobody reads more quickly."""


class Wish(msgspec.Struct, frozen=True):
    """What the page wants to see next: of which run, which series, from when to when, in how many columns.

    Times are in s since the run began; with `end` None, the newest `span` seconds. `about` and `happening` say what
    the page knows already.
    """

    run: str = ""
    series: Annotated[list[str], Meta(max_length=MOST_SERIES)] = []
    columns: Annotated[int, Meta(ge=1, le=MOST_COLUMNS)] = 600
    span: Annotated[float, Meta(gt=0, le=86400)] = 10.0
    end: float | None = None
    about: int = -1
    happening: int = 0


class Frames:
    """Makes the frames for one page."""

    def __init__(self, runs: Runs) -> None:
        self._runs = runs
        self._slow_at, self._shown = -SLOW, ""

    def __call__(self, wish: Wish, now: float) -> bytes:
        """Return a frame: the length of its head (4 bytes), the head as JSON, and the series as float32."""
        name = self._runs.chosen(wish.run)
        run = self._runs.seen.get(name)
        head: dict[str, Any] = {"run": name}
        is_slow = now - self._slow_at >= SLOW or name != self._shown
        if is_slow:
            self._slow_at, self._shown = now, name
            head["runs"] = self._runs.told()
        if run is None:
            return framed(head, [])
        columns = _grid(run, wish)
        head |= _times(run, columns) | _about(run, wish, name) | _happened(run, wish, name)
        if is_slow:
            head |= _tables(run, now)
        return framed(head | {"series": wish.series}, [_series(run, each, columns) for each in wish.series])


def framed(head: dict[str, Any], series: Sequence[NDArray[np.float32]]) -> bytes:
    """Return a frame, its numbers at a multiple of four bytes."""
    encoded = msgspec.json.encode(head)
    encoded += b" " * (-len(encoded) % 4)
    return b"".join(
        [len(encoded).to_bytes(4, "little"), encoded, *(each.astype("<f4").tobytes() for each in series)]
    )


def _grid(run: SeenRun, wish: Wish) -> Grid:
    end = run.newest if wish.end is None else run.began + round(wish.end * second)
    return grid(end - round(wish.span * second), end + 1, wish.columns)


def _times(run: SeenRun, columns: Grid) -> dict[str, Any]:
    """Return where the columns of the plots are, and how new the newest record is, in s."""
    epoch = run.run.epoch_ns if run.run is not None else 0
    return {
        "first": (columns.first - run.began) / second,
        "width": columns.width / second,
        "columns": columns.columns,
        "newest": (run.newest - run.began) / second,
        "newest_since_1970": (epoch + run.newest) / second if epoch else None,
    }


def _about(run: SeenRun, wish: Wish, name: str) -> dict[str, Any]:
    """Return what does not change, where the page does not know it yet."""
    if wish.about == run.about and wish.run == name:
        return {}
    told, signals = run.run, [{"key": f"{each.table}/{each.column}"} | each._asdict() for each in run.signals]
    about: dict[str, Any] = {"version": run.about, "signals": signals, "components": []}
    if "components" in run.tables:
        about["components"] = run.tables["components"].columns
    if told is not None:
        demons = [
            {"name": each.name, "known": each.gamma is not None and bool(each.signal)} for each in told.demons
        ]
        about |= {"demons": demons, "actions": told.actions, "control": told.control, "buttons": told.buttons}
        about |= {"ended": told.ended}
    return {"about": about}


def _happened(run: SeenRun, wish: Wish, name: str) -> dict[str, Any]:
    known = wish.happening if wish.run == name else 0
    new = [each for each in run.happenings if each.number > known] if _is_behind(run, known) else []
    return {"happened": [(each.number, (each.time - run.began) / second, each.kind, each.text) for each in new]}


def _is_behind(run: SeenRun, known: int) -> bool:
    return bool(run.happenings) and run.happenings[-1].number > known


def _tables(run: SeenRun, now: float) -> dict[str, Any]:
    return {
        "streams": [tuple(row) for row in run.watched.rows(now)],
        "state": run.watched.state(),
        "silent": now - run.heard,
        "reactions": run.reactions.told(),
        "counted": run.counted,
    }


def _series(run: SeenRun, key: str, columns: Grid) -> NDArray[np.float32]:
    """Return a series, shape (2 * columns,): nan all over where there is none of that name."""
    table, _, column = key.rpartition("/")
    try:
        if table == "return":
            return _return(run, int(column), columns)
        history = run.tables[table]
        return decimate(history.times, history.column(column), columns)
    except (KeyError, IndexError, ValueError):
        return np.full(2 * columns.columns, np.nan, np.float32)


def _return(run: SeenRun, place: int, columns: Grid) -> NDArray[np.float32]:
    states, told = run.tables["states"], run.run
    if told is None:
        raise KeyError(place)
    first = int(np.searchsorted(states.times, columns.first))
    values = returns(states, told.demons[place], first)
    if values is None:
        raise KeyError(place)
    return decimate(states.times[first:], values, columns)


def decoded(frame: bytes) -> tuple[dict[str, Any], Iterator[NDArray[np.float32]]]:
    """Return the head of a frame and its series: what the page does, for tests and tools."""
    size = int.from_bytes(frame[:4], "little")
    head = msgspec.json.decode(frame[4 : 4 + size])
    numbers = np.frombuffer(frame, "<f4", offset=4 + size)
    return head, iter(numbers.reshape(len(head.get("series", ())), -1) if numbers.size else ())
