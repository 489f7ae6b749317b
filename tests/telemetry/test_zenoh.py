"""A run on Zenoh, as others see it."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from jsonschema import validate
from parts import ROOT
from zenoh_runs import access, answers, connected, living, running, until

from rtagent.telemetry.connection import Access, TelemetryError
from rtagent.telemetry.control import command
from rtagent.telemetry.keys import place_of

PAGE = (ROOT / "docs" / "telemetry.md").read_text()
SS = shutil.which("ss") or "ss"
pytestmark = pytest.mark.slow


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def run() -> Iterator[tuple[Access, Any, str]]:
    """A run that goes on, a session beside it, and the key of the run."""
    there = access()
    with running(there), connected(there) as session:
        yield there, session, until(lambda: living(session), "the run")[0]


def test_a_plain_program_prints_the_stream(run: tuple[Access, Any, str]) -> None:
    there, _, key = run
    program = blocks("python")[0].replace("tcp/127.0.0.1:7447", there.endpoint)
    assert "rtagent import" not in program
    with subprocess.Popen([sys.executable, "-uc", program], stdout=subprocess.PIPE, text=True) as plain:
        assert plain.stdout is not None
        lines = [plain.stdout.readline() for _ in range(200)]
        plain.kill()
    streams = {line.split()[0].rsplit("/", 1)[1] for line in lines if line.startswith(key)}
    assert {"sample", "observation", "action", "transition", "components"} <= streams


def test_late_joiners_get_the_newest_of_each_stream_and_its_schema(run: tuple[Access, Any, str]) -> None:
    _, session, key = run
    newest = until(
        lambda: (found := answers(session, f"{key}/*")) and f"{key}/episode" in found and found, "an episode"
    )
    schemas = answers(session, f"{key}/@schema/*")
    for name, data in newest.items():
        validate(json.loads(data), json.loads(schemas[f"{key}/@schema/{name.rsplit('/', 1)[1]}"]))
    assert json.loads(newest[f"{key}/run"])["scenario"]["name"] == "stopping"
    assert len(schemas) == 13


def test_nothing_listens_beyond_the_loopback(run: tuple[Access, Any, str]) -> None:
    port = run[0].endpoint.rsplit(":", 1)[1]
    done = subprocess.run([SS, "-ltnH"], capture_output=True, text=True, check=True)
    mine = [line.split()[3] for line in done.stdout.splitlines() if line.split()[3].endswith(f":{port}")]
    assert mine == [f"127.0.0.1:{port}"]


def test_without_control_no_command_is_taken(run: tuple[Access, Any, str]) -> None:
    _, session, key = run
    with pytest.raises(TelemetryError, match=r"telemetry\.control = true"):
        command(session, place_of(key), "stop", "no reason")


def test_the_program_of_the_page_gets_typed_records(run: tuple[Access, Any, str]) -> None:
    there = run[0]
    program = blocks("python")[1].replace(
        'streams=("reaction",)', f'streams=("reaction",), access=Access("{there.endpoint}")'
    )
    program = program.replace(
        "import subscribe", "import subscribe\nfrom rtagent.telemetry.connection import Access"
    )
    with subprocess.Popen([sys.executable, "-uc", program], stdout=subprocess.PIPE, text=True) as plain:
        assert plain.stdout is not None
        agent, time, _ = plain.stdout.readline().split()
        plain.kill()
    assert agent == "stopping"
    assert 0 < int(time) < 10**9


def test_two_runs_and_two_viewers_come_and_go_in_any_order() -> None:
    there = access()
    with connected(there) as early, running(there):
        first = until(lambda: living(early), "the first run")
        with running(there), connected(there) as late:
            both = until(lambda: len(found := living(late)) == 2 and found, "both runs")
            assert set(first) < set(both)
            until(lambda: set(answers(late, "rtagent/*/*/sample")) == {f"{key}/sample" for key in both}, "samples")
        until(lambda: living(early) == first, "the end of the second run")


def test_commands_stop_and_annotate_where_they_are_allowed() -> None:
    there = access()
    with running(there, "telemetry.control=true") as process, connected(there) as session:
        place = place_of(until(lambda: living(session), "the run")[0])
        assert command(session, place, "annotate", "look here") == "done"
        event = until(lambda: answers(session, place.key("event")).get(place.key("event")), "the event")
        for name, text, said in (("dance", "", "no command"), ("press", "nothing", "no button")):
            with pytest.raises(TelemetryError, match=said):
                command(session, place, name, text)
        assert command(session, place, "stop", "that is enough") == "done"
        assert process.wait(10) == 1
        assert process.stderr is not None
        assert "stopped by telemetry: that is enough" in process.stderr.read()
    assert b"look here" in event or b"episode" in event


def test_a_router_that_dies_is_replaced() -> None:
    there = access()
    with running(there):
        with connected(there) as session:
            until(lambda: living(session), "the run")
            found = subprocess.run([SS, "-ltnpH"], capture_output=True, text=True, check=True).stdout
        port = there.endpoint.rsplit(":", 1)[1]
        (line,) = [line for line in found.splitlines() if f":{port} " in line]
        os.kill(int(re.findall(r"pid=(\d+)", line)[0]), signal.SIGKILL)
        with connected(there) as session:
            until(lambda: living(session), "the run at another router")


def test_what_the_page_says_about_other_machines_works(tmp_path: Any) -> None:
    there, other = access(), access().endpoint.replace("tcp/127.0.0.1", "tls/localhost")
    setup, watch = blocks("sh")
    subprocess.run([str(shutil.which("bash")), "-euc", setup], cwd=tmp_path, check=True, capture_output=True)
    table = blocks("toml")[0].replace("tcp/127.0.0.1:7447", there.endpoint).replace("7448", other.rsplit(":", 1)[1])
    (tmp_path / "open.toml").write_text((ROOT / "scenarios" / "stopping.toml").read_text() + table)

    def watched(line: str) -> tuple[int, str]:
        arguments = line.replace("tls/localhost:7448", other).split()[1:]
        done = subprocess.run(
            [sys.executable, "-m", "rtagent", *arguments, "--once"], cwd=tmp_path, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        return done.returncode, done.stdout + done.stderr

    (tmp_path / "wrong").write_text("sesame")
    with running(there, scenario=tmp_path / "open.toml", cwd=tmp_path):
        until(lambda: "goes on" in watched(watch)[1], "the run")
        for refused in (
            watch.replace("--password-file password", "--password-file wrong"),
            watch.replace("--ca ca.pem", ""),
            f"rtagent watch --endpoint {there.endpoint}",
        ):
            code, said = watched(refused)
            assert code == 2, refused
            assert "lets nobody in" in said
