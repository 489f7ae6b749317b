"""`rtagent devices`: servos found on emulated buses, adapters looked at, each problem with its cure."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from wire import EmulatedArm

from rtagent import ms, us
from rtagent.__main__ import main
from rtagent.commands import devices
from rtagent.finding import Search
from rtagent_drivers import adapter
from rtagent_drivers.dynamixel import faults, probe, scan
from rtagent_drivers.dynamixel.packets import Write

pytestmark = pytest.mark.slow

BAUDS, IDS = [1_000_000], range(1, 7)


@pytest.fixture(scope="module")
def bento(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Five servos from the factory, of which the fourth has a latched overload."""
    folder, overload = tmp_path_factory.mktemp("bus"), '{"kind": "overload", "servo": 4}'
    with EmulatedArm(folder, "bento", "--return-delay", "500us", "--fault", overload) as arm:
        yield arm.port


async def test_servos_of_protocol_1_are_found_with_what_is_to_know_of_them(bento: str) -> None:
    found = await scan.scan(bento, BAUDS, IDS, protocols=[1])
    assert [(each.servo, each.models[0].name) for each in found] == [
        (1, "MX-64"),
        (2, "MX-106"),
        (3, "MX-28"),
        (4, "MX-28"),
        (5, "MX-28"),
    ]
    assert {(each.protocol, each.baud, each.return_delay, each.torque) for each in found} == {
        (1, 1_000_000, 500 * us, False)
    }
    assert [list(each.complaints) for each in found] == [[], [], [], [faults.OVERLOAD], []]


async def test_servos_of_protocol_2_answer_a_call_to_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan, "TURN", 200 * us)
    with EmulatedArm(tmp_path, "mini_bento", "--baud", "57600baud") as arm:
        found = await scan.scan(arm.port, [1_000_000, 57_600], range(40), protocols=[2])
    assert [(each.servo, each.baud, each.models[0].name) for each in found] == [
        (servo, 57_600, "XL330-M288") for servo in range(1, 6)
    ]


async def test_a_return_delay_is_mended_but_not_under_torque(bento: str) -> None:
    async with scan.calling(bento, 1_000_000, 1, 1) as bus:
        still = await scan.look(bus, 5)
        torque_enable = still.models[0].registers["torque_enable"]
        await bus.transact(bus.codec.write(Write(5, torque_enable.address, b"\x01")), {5: 0})
        assert (await scan.mend(bus, await scan.look(bus, 5))).return_delay == 500 * us
        assert (await scan.look(bus, 5)).torque
        await bus.transact(bus.codec.write(Write(5, torque_enable.address, b"\x00")), {5: 0})
        assert (await scan.mend(bus, await scan.look(bus, 5))).return_delay == 0
        await bus.transact(bus.codec.write(Write(5, 5, bytes((250,)))), {5: 0})


@pytest.mark.parametrize(("robot", "protocol"), [("bento", 1), ("mini_bento", 2)])
async def test_a_servo_that_has_shut_down_recovers_and_stays_limp(
    robot: str, protocol: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scan, "REBOOTING", 200 * ms)
    monkeypatch.setattr(scan, "REBOOTING", 300 * ms)
    with EmulatedArm(tmp_path, robot) as arm:
        async with scan.calling(arm.port, 1_000_000, protocol, 1) as bus:
            register = (await scan.look(bus, 2)).models[0].registers["torque_enable"]
            await bus.transact(bus.codec.write(Write(2, register.address, b"\x01")), {2: 0})
            arm.fault("overload", 2)
            arm.mend()
            broken = await scan.look(bus, 2)
            assert (broken.shut_down, list(broken.complaints)) == (True, [faults.OVERLOAD])
            mended = await scan.mend(bus, broken)
        assert (mended.shut_down, mended.torque, list(mended.complaints)) == (False, False, [])
        assert not arm.state()["elbow"]["torque"]


async def test_what_a_servo_does_not_say_is_not_taken_for_zero(tmp_path: Path) -> None:
    """A torque limit of 0, or torque that is off, would have it mended: one that is mute is left alone."""
    with EmulatedArm(tmp_path) as arm:
        async with scan.calling(arm.port, 1_000_000, 1, 253) as bus:
            arm.fault("silent", 2)
            mute = await scan.look(bus, 2)
            assert (mute.number, mute.torque, mute.shut_down, list(mute.complaints)) == (0, None, False, [])
            assert await scan.mend(bus, mute) == mute


def test_the_command_tells_of_each_servo_and_how_to_mend_it(bento: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--port", bento, "--ids", "1,4", "--bauds", "1000000", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)[bento]
    servos = [each for each in found if each["name"].startswith("servo")]
    assert [each["name"] for each in servos] == ["servo 1", "servo 4", "servo 4"]
    assert servos[0]["value"] == (
        "MX-64, firmware 40, protocol 1.0 at 1000000 bit/s, return delay 500 µs, torque off"
    )
    assert servos[0]["cure"] == f"rtagent devices --port {bento} --ids 1 --mend sets it to 0."
    assert servos[1]["problem"] == "it has been overloaded and lets go of its joint."
    assert main(["devices", "--port", bento, "--ids", "1", "--bauds", "1000000", "--mend"]) == 0
    printed = capsys.readouterr().out
    assert "return delay 0 ns" in printed
    assert "problem" not in printed


def test_a_line_on_which_nobody_answers_is_told(bento: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--port", bento, "--ids", "9", "--bauds", "1000000"]) == 0
    assert "no servo answers at 1000000 bit/s" in capsys.readouterr().out


def test_a_port_that_is_not_there_is_a_fault(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--port", "/dev/nowhere"]) == 1
    told = capsys.readouterr().out
    assert told.count("there is no port /dev/nowhere.") == 1


def test_a_machine_without_adapters_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(devices, "comports", list)
    assert main(["devices"]) == 0
    assert "no USB serial port is plugged in." in capsys.readouterr().out


@pytest.mark.parametrize("option", [["--ids", "1-"], ["--ids", "x"], ["--bauds", "0"], ["--bauds", "fast"]])
def test_ids_and_rates_that_are_none_have_a_sentence(option: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["devices", *option])
    assert ": write " in capsys.readouterr().err


def test_ids_are_lists_of_ranges() -> None:
    assert devices.ids("1-3,9,20-21") == [1, 2, 3, 9, 20, 21]


async def test_an_adapter_is_looked_at_before_what_hangs_on_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = tmp_path / "ttyUSB7"
    port.touch()
    known = SimpleNamespace(device=str(port), description="U2D2", vid=0x0403, pid=0x6014, serial_number="FT1234")
    monkeypatch.setattr(adapter, "comports", lambda: [known])
    monkeypatch.setattr(adapter, "latency_timer", lambda path: 16)
    monkeypatch.setattr(adapter, "holders", lambda path: ["python3 (process 4711)"])
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    kind, permission, users, latency = await adapter.probe(str(port), Search())
    assert kind.value == "U2D2 (0403:6014, serial number FT1234)"
    assert permission.essential
    assert permission.cure.startswith("sudo usermod -aG ")
    assert users.value == "python3 (process 4711)"
    assert "16 ms" in latency.problem
    assert "echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB7/latency_timer;" in latency.cure
    assert adapter.UDEV_RULE in latency.cure


async def test_a_port_that_may_be_anything_is_not_spoken_to_unless_it_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arduino = SimpleNamespace(device="/dev/ttyACM0", vid=0x2341)
    monkeypatch.setattr(probe, "comports", lambda: [arduino])
    (found,) = await probe.probe("/dev/ttyACM0", Search())
    assert "rtagent devices --port /dev/ttyACM0" in found.value


def test_every_finding_of_a_servo_with_a_problem_has_a_cure() -> None:
    servo = scan.Found(3, 2, 57_600, 4711, 1, 508 * us, None, False, ["is hot: wait."])
    found = probe._findings("/dev/ttyUSB0", servo)
    assert [bool(each.problem and each.cure) for each in found] == [True, True, True]
    assert found[0].value.startswith("unknown model 4711")
    assert found[1].cure.startswith("support the arm, switch its torque off, then rtagent devices")


async def test_few_servos_are_waited_for_longer_than_many(bento: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan, "latency_timer", lambda path: 16)
    patience = []
    for count in (1, 253):
        async with scan.calling(bento, 1_000_000, 1, count) as bus:
            patience.append(bus.patience)
    assert patience == [66 * ms, pytest.approx(2000 / 253 * ms + 16 * ms, rel=1e-3)]
