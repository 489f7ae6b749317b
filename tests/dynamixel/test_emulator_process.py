"""The emulator as a process: its link, its orders, its log, its end, and what it costs while nothing happens."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial
from wire import EmulatedArm

from rtagent.__main__ import main
from rtagent_drivers.dynamixel.packets import Instruction, Request
from rtagent_drivers.dynamixel.protocol1 import PROTOCOL1

pytestmark = pytest.mark.slow

PING = PROTOCOL1.request(Request(1, Instruction.PING))
PONG = bytes.fromhex("FF FF 01 02 00 FC")
EMULATE = [sys.executable, "-m", "rtagent", "emulate"]


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[EmulatedArm]:
    with EmulatedArm(tmp_path, "bento", "--log", str(tmp_path / "log"), "--timing", "true") as arm:
        yield arm


def comes(condition: Callable[[], bool]) -> bool:
    ends = time.monotonic() + 10.0
    while not condition():
        if time.monotonic() > ends:
            return False
        time.sleep(0.01)
    return True


def asked(port: str, request: bytes = PING, baud: int = 1_000_000, wait: float = 5.0) -> bytes:
    with serial.Serial(port, baud, timeout=wait) as line:
        line.write(request)
        return line.read(len(PONG))


def test_it_is_unplugged_and_plugged_in_again_under_the_same_name(arm: EmulatedArm) -> None:
    link = Path(arm.port)
    with serial.Serial(arm.port, 1_000_000, timeout=5.0) as line:
        line.write(PING)
        assert line.read(len(PONG)) == PONG
        arm.fault("unplug")
        assert comes(lambda: not link.is_symlink())
        with pytest.raises(serial.SerialException):
            line.read(1)
    arm.mend()
    assert comes(link.is_symlink)
    assert asked(arm.port) == PONG


def test_it_hears_its_own_baud_rate_only(arm: EmulatedArm) -> None:
    assert asked(arm.port, baud=57_600, wait=0.05) == b""
    assert asked(arm.port) == PONG


def test_it_sleeps_while_nothing_happens(arm: EmulatedArm) -> None:
    asked(arm.port)
    arm.state()
    time.sleep(0.05)  # so long it may still be attentive
    before, began = busy(arm.pid), time.monotonic()
    time.sleep(0.3)
    assert busy(arm.pid) - before <= 0.1 * (time.monotonic() - began)


def busy(pid: int) -> float:
    """Return how many seconds a process has had a processor."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_its_log_says_what_happened_when_and_where_the_joint_was(arm: EmulatedArm, tmp_path: Path) -> None:
    before = time.monotonic_ns()
    assert asked(arm.port, bytes.fromhex("FF FF 01 05 03 1E 00 08 D0")) == PONG  # goal position 2048
    after = time.monotonic_ns()
    arm.fault("silent", 2)
    told = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert [(what.get("joint"), what["event"], what["value"]) for what in told] == [
        ("shoulder", "torque_enable", 1),
        ("shoulder", "goal_position", 0.0),
        (None, "fault", "silent"),
    ]
    assert before <= told[0]["time"] <= told[1]["time"] <= after
    assert abs(told[1]["position"]) < 1e-6


def test_it_ends_some_time_after_its_input_and_takes_its_link_away(tmp_path: Path) -> None:
    link = tmp_path / "arm"
    command = [*EMULATE, "mini_bento", "--link", str(link), "--linger", "100ms"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        assert process.stdout.readline().strip() == str(link)
        process.stdin.close()
        assert link.is_symlink(), "it lingers"
        assert process.wait(timeout=20) == 0
    assert not os.path.lexists(link)


def test_bad_orders_are_told_and_leave_it_at_work(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with EmulatedArm(tmp_path) as arm:
        arm.tell(do="dance")
        arm.tell(do="move", joint="tail", to="1rad")
        assert arm.state()
        assert asked(arm.port) == PONG
    said = capfd.readouterr().err
    assert "says not what to do" in said
    assert "no joint 'tail'" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["bento", "--baud", "4Mbaud"], "do not have 4000000 baud"),
        (["bento", "--fault", '{"kind": "tired"}'], "kind"),
        (["bento", "--joints", '[{"name": "a", "id": 1}]'], "model"),
        (["mini_bento", "--protocol", "1"], "does not speak protocol 1"),
        (["bent"], "did you mean 'bento'"),
    ],
)
def test_what_cannot_be_emulated_is_said(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["emulate", *arguments, "--link", str(tmp_path / "arm")]) == 2
    assert said in capsys.readouterr().err
    assert not os.path.lexists(tmp_path / "arm")


@pytest.mark.parametrize("place", ["a file", "no folder/arm"])
def test_a_link_that_cannot_be_is_said(place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a file").write_text("precious")
    assert main(["emulate", "bento", "--link", str(tmp_path / place)]) == 2
    assert "give another name" in capsys.readouterr().err
    assert (tmp_path / "a file").read_text() == "precious"
