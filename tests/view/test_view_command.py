"""The command `rtagent view`: where it cannot serve, and that it ends."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys

import pytest

from rtagent.__main__ import main
from rtagent.telemetry.subscribe import Reader


def test_a_port_that_is_taken_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["view", "--port", str(port)]) == 2
    said = capsys.readouterr().err
    assert f"--port {port}: " in said
    assert "Give another, or 0 for any." in said


@pytest.mark.parametrize("port", ["-1", "65536", "http"])
def test_what_is_no_port_is_refused(port: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["view", f"--port={port}"])
    assert "is no port: give a number up to 65535" in capsys.readouterr().err


@pytest.mark.parametrize(
    "data", [b"", b"{", b'{"sequence": 1}', b'{"sequence": 1, "time_ns": 2, "name": 3, "text": ""}']
)
def test_what_others_publish_ends_nobodys_watching(data: bytes) -> None:
    reader = Reader()
    assert reader.read("rtagent/arm/1/event", data) is None
    assert reader.read("rtagent/arm/1/event", b'{"sequence": 4, "time_ns": 2, "name": "x", "text": ""}') is not None


@pytest.mark.slow
def test_ctrl_c_ends_it_though_a_session_is_open() -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    command = [sys.executable, "-m", "rtagent", "view", "--port", "0", "--endpoint", endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as view:
        assert view.stdout is not None
        assert "http://127.0.0.1:" in view.stdout.readline()
        with pytest.raises(subprocess.TimeoutExpired):
            view.wait(2)
        view.send_signal(signal.SIGINT)
        assert view.communicate(timeout=20)[1] == ""
        assert view.returncode == 0
