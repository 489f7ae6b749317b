"""The live view in Chromium: from a sample to pixels, frames and bytes a second, what the server costs."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from _harness import Row

from rtagent.telemetry.connection import Access, open_client
from rtagent.telemetry.keys import Place
from rtagent.telemetry.link import epoch
from rtagent.telemetry.records import DeviceSignals, Run, Sample, Signal
from rtagent.units import ms, second

sys.path.append(str(Path(__file__).parents[1] / "tests" / "view"))  # the page is driven as the tests drive it
from browser import Viewed, browser, free_port, view_of, viewed

STEPS = 40
EVERY = 300 * ms
"""The signal steps so often; at 1 kHz there are 300 samples between."""
SETTLING = 3.0
"""How long (s) the page runs before anything is measured."""
MEASURED = 10.0

PROBE = """
const size = 16; // px at the right end of the line in which the step is looked for
const seen = (window.stepsSeen = []);
let level = null;
const look = () => {
  const plot = document.querySelector("[data-plot='sample/board/x'] .u-over");
  const canvas = plot.parentElement.querySelector("canvas");
  const box = { left: plot.offsetLeft, top: plot.offsetTop, width: plot.offsetWidth, height: plot.offsetHeight };
  const { data } = canvas.getContext("2d").getImageData(box.left + box.width - size, box.top, size, box.height);
  const columns = [];
  for (let x = size - 1; x >= 0; x--) {
    const rows = [];
    for (let y = 2; y < box.height - 2; y++) {
      const at = 4 * (y * size + x);
      const colours = data.slice(at, at + 3);
      if (data[at + 3] > 120 && Math.max(...colours) - Math.min(...colours) > 60) rows.push(y);
    }
    if (rows.length) columns.push(rows.length > 6 ? "edge" : rows[0] < box.height / 2 ? 1 : 0);
  }
  const flat = columns.find((each) => each !== "edge");
  const last = columns[0] === "edge" && flat !== undefined ? 1 - flat : flat ?? null;
  if (last !== null && last !== level) {
    level = last;
    requestAnimationFrame(() => seen.push([level, (performance.timeOrigin + performance.now()) / 1000]));
  }
  requestAnimationFrame(look);
};
requestAnimationFrame(look);
"""
"""Runs in the page, and notes when the pixels at the end of the line are those of another level."""


def view_rows() -> Iterator[Row]:
    """Yield what is measured with a run at 1 kHz, and with steps that are looked for in the pixels."""
    with viewed() as (page, _):
        time.sleep(SETTLING)
        yield from _with_a_run(page)
    with _board() as (page, stepped):
        yield from _steps(page, stepped)


def _with_a_run(page: Viewed) -> Iterator[Row]:
    before = _processor(page.server)
    page.window.execute_script("rtagentView.measured.frames.length = 0")
    time.sleep(MEASURED)
    used = (_processor(page.server) - before) / MEASURED
    frames: list[dict[str, Any]] = page("rtagentView.measured.frames")
    late = 1000 * _latencies(frames)
    for name, part in (("p50", 50), ("p99", 99)):
        yield Row(f"run at 1 kHz, 112 demons: record to pixels, {name}", float(np.percentile(late, part)), "ms")
    length = frames[-1]["at"] - frames[0]["at"]
    yield Row("run at 1 kHz: frames", (len(frames) - 1) / length, "/s", reach=10, better="higher")
    yield Row("run at 1 kHz: sent to the page", sum(frame["bytes"] for frame in frames) / length / 1000, "kB/s")
    yield Row("run at 1 kHz: the largest frame", max(frame["bytes"] for frame in frames) / 1000, "kB", reach=200)
    yield Row("run at 1 kHz: the server's processor", 100 * used, "%")
    yield Row("run at 1 kHz: records that the page missed", _missed(page), "")


def _latencies(frames: list[dict[str, Any]]) -> np.ndarray[Any, Any]:
    """Return how long after its time each ms of the run was first in the pixels, in s: shape (ms,)."""
    newest, at = (np.array([frame[name] for frame in frames]) for name in ("newest", "at"))
    times = np.arange(newest[0], newest[-1], 0.001)
    late: np.ndarray[Any, Any] = at[np.searchsorted(newest, times)] - times
    return late


def _missed(page: Viewed) -> float:
    told = page.text("#missed").split()[0].replace(",", "")
    return 0.0 if told == "nothing" else float(told)


def _processor(pid: int) -> float:
    """Return how long (s) a process has had a processor."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100


def _steps(page: Viewed, stepped: list[tuple[int, float]]) -> Iterator[Row]:
    page.window.execute_script(PROBE)
    first = len(stepped) + 2
    page.until(lambda: len(stepped) > first + STEPS, "the signal steps")
    time.sleep(1)
    seen: list[tuple[int, float]] = page("stepsSeen")
    late = [lag for level, then in stepped[first : first + STEPS] if (lag := _lag(level, then, seen)) is not None]
    yield Row("step at 1 kHz: steps of 40 not found in the pixels", STEPS - len(late), "", reach=2)
    yield Row("step at 1 kHz: sample to pixels, p50", 1000 * float(np.median(late)), "ms", reach=100)
    yield Row("step at 1 kHz: sample to pixels, p95", 1000 * float(np.percentile(late, 95)), "ms")


def _lag(level: int, then: float, seen: list[tuple[int, float]]) -> float | None:
    lags = [at - then for found, at in seen if found == level and 0 <= at - then < EVERY / second]
    return min(lags, default=None)


@contextmanager
def _board() -> Iterator[tuple[Viewed, list[tuple[int, float]]]]:
    """Give a page that shows a signal which steps, and when it did (s since 1970)."""
    endpoint, ending, stepped = f"tcp/127.0.0.1:{free_port()}", threading.Event(), list[tuple[int, float]]()
    with ExitStack() as stack:
        address, pid = stack.enter_context(view_of(endpoint))
        session = stack.enter_context(open_client(Access(endpoint=endpoint)))
        thread = threading.Thread(target=_publish, args=(session, ending, stepped))
        thread.start()
        stack.callback(thread.join)
        stack.callback(ending.set)
        page = Viewed(stack.enter_context(browser()), address, endpoint, pid)
        page.window.get(address)
        page.until(lambda: page.count("[data-plot='sample/board/x'] canvas") == 1, "the signal is plotted")
        page.window.execute_script("rtagentView.view.span = 2")
        time.sleep(SETTLING)
        yield page, stepped


def _publish(session: Any, ending: threading.Event, stepped: list[tuple[int, float]]) -> None:
    """Publish 1000 samples a second, and note when their value is another one."""
    encode, place, since, level = msgspec.json.Encoder().encode, Place("board", "1"), epoch(), -1
    begin = time.monotonic_ns()
    for number in range(10**9):
        if ending.wait(max(0, (begin + number * ms - time.monotonic_ns()) / second)):
            return
        now = time.monotonic_ns()
        before, level = level, (now - begin) // EVERY % 2
        if level != before:
            stepped.append((level, (since + now) / second))
        if number % 1000 == 0:  # the view may have begun to listen only now
            session.put(place.key("run"), encode(_run(since, number // 1000)))
        session.put(place.key("sample"), encode(Sample(
            sequence=number, time_ns=now, device="board", number=number, values={"x": level}, world_time_ns=now,
            arrival_time_ns=now, time_source="device",
        )))  # fmt: skip


def _run(since: int, number: int) -> Run:
    board = DeviceSignals({"x": Signal("float64", [], "", 0.0, 1.0)}, {}, 1000.0)
    return Run(
        sequence=number, time_ns=time.monotonic_ns(), agent="board", run="1", epoch_ns=since, clock="real", seed=1,
        scenario={}, machine={}, versions={}, devices={"board": board}, state=[], actions=[], demons=[], buttons=[],
        control=False,
    )  # fmt: skip
