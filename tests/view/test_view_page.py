"""The page of the live view in a real browser, driven as a person would."""

from __future__ import annotations

import http.server
import json
import re
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from browser import PATIENCE, Viewed, browser, colours, found_tools, run_at, viewed
from selenium.webdriver.common.keys import Keys
from websockets.sync.client import connect
from websockets.typing import Origin

from rtagent.view.frames import decoded

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::ResourceWarning")]  # selenium's own sockets


@pytest.fixture(scope="module")
def page_and_run() -> Iterator[tuple[Viewed, subprocess.Popen[str]]]:
    with viewed() as both:
        yield both


@pytest.fixture
def page(page_and_run: tuple[Viewed, subprocess.Popen[str]]) -> Viewed:
    """The page, loaded anew, with nothing chosen by hand."""
    shown = page_and_run[0]
    shown.window.execute_script("localStorage.clear()")
    shown.load()
    return shown


def test_it_shows_a_run_at_a_glance(page: Viewed) -> None:
    assert page.text("#state") == "goes on (real clock)"
    assert "stopping_horde/" in page.text("#run")
    page.until(lambda: page.ink("[data-plot='unit rad']") > 100, "a line is drawn")
    page.until(lambda: page.ink("[data-plot='prediction/0']") > 50, "predictions are drawn")
    page.until(lambda: page.ink("[data-plot='components']") > 50, "component times are drawn")
    page.until(lambda: page.count("#histogram canvas") == 1, "there were reactions")
    page.until(lambda: "reaction" in page.text("#reaction-parts"), "and their quantiles")
    page.until(lambda: "stimulus" in page.text("#happened"), "events are listed")
    assert "sample" in page.text("#streams")
    before = float(page.text("#time").split()[0])
    page.until(lambda: float(page.text("#time").split()[0]) > before + 1, "time goes on")
    assert page.complaints() == []


def test_a_return_follows_its_prediction(page: Viewed) -> None:
    title = page.find("[data-plot='prediction/0']").text
    assert "prediction and return" in title
    assert page("document.querySelectorAll(\"[data-plot='prediction/0'] .u-series\").length") == 3


def test_a_signal_is_chosen_and_the_choice_is_kept(page: Viewed) -> None:
    plot = "[data-plot='unit rad']"
    assert "shoulder_position" not in page.find(plot).get_attribute("aria-label")  # type: ignore[operator]
    page.press("s")
    page.press("shoulder_pos")
    page.until(lambda: page.count("#choices .choice") == 5, "one signal and four demons fit")
    page.find("[name='sample/arm/shoulder_position']").click()
    assert "shoulder_position" in page.find(plot).get_attribute("aria-label")  # type: ignore[operator]
    page.load()
    assert "shoulder_position" in page.find(plot).get_attribute("aria-label")  # type: ignore[operator]
    page.find("[name='sample/joint/position']").click()
    page.find("[name='sample/arm/shoulder_position']").click()
    assert page.count(plot) == 0


def view(page: Viewed) -> dict[str, Any]:
    return dict(page("rtagentView.view"))


def test_a_part_is_dragged_over_to_zoom_and_all_plots_follow(page: Viewed) -> None:
    page.find("#pause").click()
    before = view(page)
    page.drag("[data-plot='unit rad'] .u-over", 0.4, 0.6)
    page.until(lambda: view(page)["span"] < before["span"], "it has zoomed")
    after = view(page)
    assert after["span"] == pytest.approx(0.2 * before["span"], rel=0.1)
    assert after["end"] == pytest.approx(before["end"] - 0.4 * before["span"], abs=0.05 * before["span"])
    page.press("-")
    assert view(page)["span"] == pytest.approx(2 * after["span"])
    page.press("l")
    assert (view(page)["end"], view(page)["span"]) == (None, before["span"])


def test_pause_holds_the_plots_while_the_run_goes_on(page: Viewed) -> None:
    page.press("p")
    assert page.find("#pause").get_attribute("aria-pressed") == "true"
    held, samples = view(page), page.text("#streams tr:nth-child(3)")
    page.until(lambda: page.text("#streams tr:nth-child(3)") != samples, "records come")
    assert view(page) == held
    page.press(Keys.ARROW_LEFT)
    assert view(page)["end"] == pytest.approx(held["end"] - held["span"] / 4)
    page.press("p")
    assert view(page)["end"] is None


def test_a_moment_is_marked_and_the_mark_comes_back_from_the_run(page: Viewed) -> None:
    page.press("m")
    page.press("the arm was touched", Keys.ENTER)
    page.until(lambda: "the arm was touched" in page.text("#happened"), "the mark is listed")
    assert page.count("#happened .kind.annotation") >= 1
    page.load()
    page.until(lambda: "the arm was touched" in page.text("#happened"), "it was not the page that kept it")


def test_all_can_be_reached_by_the_keyboard_in_the_order_in_which_it_stands(page: Viewed) -> None:
    reached: list[str] = []
    page.window.execute_script("document.activeElement.blur()")
    for _ in range(16):
        page.press(Keys.TAB)
        reached.append(page("document.activeElement.id || document.activeElement.textContent.trim()"))
    wanted = ["run", "pause", "live", "closer", "wider", "span", "mark-text", "Mark M", "stop", "theme", "filter"]
    assert [each for each in reached if each in wanted] == wanted
    unnamed = page("""[...document.querySelectorAll('button, input, select')].filter((each) =>
        !(each.ariaLabel || each.textContent.trim() || each.labels?.[0]?.textContent.trim())).length""")
    assert unnamed == 0


CONTRAST = """((text, ground) => {
  const light = (name) => {
    const hex = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    const parts = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
    const [r, g, b] = parts.map((part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const [high, low] = [light(text), light(ground)].sort((a, b) => b - a);
  return (high + 0.05) / (low + 0.05);
})"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_is_legible_in_the_light_and_in_the_dark(page: Viewed, scheme: str) -> None:
    colours(page.window, scheme)
    page.until(lambda: page("document.documentElement.dataset.theme") == scheme, "it follows the system")
    for text, ground, least in [
        ("--text", "--card", 7), ("--quiet", "--card", 4.5), ("--quiet", "--ground", 4.5),
        ("--good", "--card", 4.5), ("--warn", "--card", 4.5), ("--bad", "--card", 4), ("--accent", "--card", 4.5),
        ("--bad-text", "--bad", 3.9),
        *((f"--s{number}", "--card", 4.5) for number in range(1, 9)),
    ]:  # fmt: skip
        assert page(f"{CONTRAST}('{text}', '{ground}')") >= least, (text, ground)
    page.press("t")
    assert page("document.documentElement.dataset.theme") != scheme
    colours(page.window, "light")


def test_one_of_several_runs_is_chosen(page: Viewed) -> None:
    first = view(page)["run"]
    with run_at(page.endpoint):
        page.until(lambda: page.count("#run option") == 2, "the other run is there")
        assert view(page)["run"] == first
        page.find("#run option:not(:checked)").click()
        page.until(lambda: page.ink("[data-plot='unit rad']") > 20, "the other one is shown")
        assert view(page)["run"] != first
    page.until(
        lambda: "ended" in page.text("#state") or "silent" in page.text("#state"), "it is told that it ended"
    )


def memory(pid: int) -> int:
    """Return how much memory a process holds, in kB."""
    with open(f"/proc/{pid}/status") as file:  # noqa: PTH123  # no path of ours
        return next(int(line.split()[1]) for line in file if line.startswith("VmRSS"))


def newest_at_the_server(page: Viewed) -> float:
    """Return the time (s since 1970) of the newest record that the server has: a run may be behind itself."""
    with connect(page.address.replace("http", "ws") + "/stream", origin=Origin(page.address)) as stream:
        stream.send(json.dumps({"wish": {"run": view(page)["run"]}}))
        frame = stream.recv(timeout=PATIENCE)
    assert isinstance(frame, bytes)
    return float(decoded(frame)[0]["newest_since_1970"])


def test_a_slow_browser_is_sent_less_and_stays_up_to_date(page: Viewed) -> None:
    def frames_a_second() -> float:
        return float(
            page("""(({ frames }) => 20 / (frames.at(-1).at - frames.at(-21).at))(rtagentView.measured)""")
        )

    page.until(lambda: page("rtagentView.measured.frames.length > 30"), "frames come")
    quick = frames_a_second()
    page.window.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": 12})
    try:
        seen = page("rtagentView.measured.frames.at(-1).at")
        page.until(
            lambda: page(f"rtagentView.measured.frames.filter(({{ at }}) => at > {seen}).length > 25"), "they do"
        )
        held = memory(page.server)
        assert frames_a_second() < max(quick, 20), "where others use the processors too, it was slow before"
        newest = page("rtagentView.measured.frames.at(-1)")
        size = page("Math.max(...rtagentView.measured.frames.slice(-10).map(({ bytes }) => bytes))")
        assert newest_at_the_server(page) - newest["newest"] < 5, "what is seen is not what came long ago"
        assert size < 400_000
        assert memory(page.server) < held + 50_000
    finally:
        page.window.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": 1})


STRANGER = b"""<!doctype html><title>waiting</title><script>
const said = {};
const done = () => { if (Object.keys(said).length === 3) document.title = JSON.stringify(said); };
const tell = (name, value) => { said[name] = value; done(); };
const socket = new WebSocket("ws://ADDRESS/stream");
socket.onopen = () => { tell("socket", "open"); };
socket.onerror = () => { tell("socket", "refused"); };
fetch("http://ADDRESS/main.js").then(() => tell("fetch", "read"), () => tell("fetch", "refused"));
const script = Object.assign(document.createElement("script"), { src: "http://ADDRESS/main.js", type: "module" });
script.onload = () => tell("script", "loaded");
script.onerror = () => tell("script", "refused");
document.head.append(script);
</script>"""


@contextmanager
def stranger(address: str) -> Iterator[str]:
    """Give the address of a page of another origin, that wants to read what a run tells."""

    class Answer(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(STRANGER.replace(b"ADDRESS", address.encode()))

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002  # so it is called there
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answer) as server:
        threading.Thread(target=server.serve_forever).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


def test_a_page_from_another_origin_is_refused(page: Viewed) -> None:
    with stranger(page.address.removeprefix("http://")) as address, browser() as window:
        window.get(address)
        shown = Viewed(window, address, "", 0)
        said = shown.until(lambda: window.title.startswith("{") and window.title, "all three were tried")
    assert json.loads(said) == {"socket": "refused", "fetch": "refused", "script": "refused"}


def test_the_stop_button_stops_the_run(page_and_run: tuple[Viewed, subprocess.Popen[str]]) -> None:
    page, run = page_and_run
    page.load()
    page.until(lambda: page.find("#stop").click() or run.poll() is not None, "it stops")
    assert run.poll() != 0
    page.until(lambda: re.match("ended|silent", page.text("#state")), "the page tells that it goes on no more")
    if "ended" in page.text("#state"):  # a last record that was dropped on its way leaves it silent
        page.until(lambda: not page.find("#stop").is_enabled(), "nothing is left to be stopped")
    assert page.complaints() == []


def test_without_control_the_buttons_say_why_they_cannot_be_used() -> None:
    found_tools()
    with viewed(("run.episodes=100000", "horde.demons.0.bins=0", "telemetry.control=false")) as (page, _):
        for control in ("#stop", "#mark-text", "#mark button"):
            assert not page.find(control).is_enabled()
            assert "control = true" in str(page.find(control).get_attribute("title"))
        page.press("S")
        assert page.text("#state") == "goes on (real clock)"
