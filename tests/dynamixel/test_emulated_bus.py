"""The emulated bus, with no I/O: the public e-manual's own packets, rules of access, safety, faults, timing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent.errors import SpecError
from rtagent.units import ms, second, us
from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.emulated.bus import EmulatedBus
from rtagent_drivers.dynamixel.emulated.control import obey, read_fault
from rtagent_drivers.dynamixel.emulated.faults import Fault
from rtagent_drivers.dynamixel.emulated.robots import BENTO, MINI_BENTO, ROBOTS, Joint
from rtagent_drivers.dynamixel.packets import BROADCAST, Instruction, Request, Span, Status, Write
from rtagent_drivers.dynamixel.protocol2 import PROTOCOL2, split_fast
from rtagent_drivers.dynamixel.steps import Body
from rtagent_drivers.dynamixel.timing import transaction
from rtagent_drivers.dynamixel.values import pack, unpack

COUNT = 0.0015339807878856412  # 2π / 4096
OVERLOAD, OVERHEATING, VOLTAGE = 0x20, 0x04, 0x01
ROOM = Body(friction=0.05)


class Host:
    """A host on an emulated bus: it lets time pass, asks, and takes the answers."""

    def __init__(self, joints: Sequence[Joint], protocol: int, **settings: Any) -> None:
        self.log: list[dict[str, Any]] = []
        self.now = 1000 * second
        self.bus = EmulatedBus(joints, protocol, self.now, log=self.log.append, **settings)
        self.codec, self._decoder = codec(protocol), codec(protocol).status_decoder()

    def say(self, data: bytes) -> bytes:
        """Send bytes; return all that comes within 50 ms."""
        self.bus.receive(self.now, data)
        heard, until = b"", self.now + 50 * ms
        while (due := self.bus.due()) is not None and due <= until:
            self.now = max(self.now, due)
            heard += self.bus.take(self.now)
        self.now += ms
        return heard

    def ask(self, request: Request) -> list[Status]:
        found = list(self._decoder.feed(self.say(self.codec.request(request))))
        return found + list(self._decoder.reset())

    def write(self, servo: int, name: str, count: int) -> int:
        """Write a register; return the error of the answer, -1 where none came."""
        register = self.bus.servo(servo).model.registers[name]
        answers = self.ask(self.codec.write(Write(servo, register.address, pack(register, count))))
        return answers[0].error if answers else -1

    def read(self, servo: int, name: str) -> int:
        register = self.bus.servo(servo).model.registers[name]
        (answer,) = self.ask(self.codec.read(Span(servo, register.address, register.size)))
        return unpack(register, answer.parameters)

    def wait(self, duration: int) -> None:
        self.now += duration
        self.bus.take(self.now)

    def events(self, name: str) -> list[tuple[int, Any]]:
        return [(what["servo"], what["value"]) for what in self.log if what["event"] == name and "servo" in what]


def one(model: str, **joint: Any) -> Host:
    settings: Mapping[str, Any] = {"name": "joint", "id": 1, "model": model, "body": ROOM, **joint}
    return Host([Joint(**settings)], 2 if model[:2] in ("XL", "XM") or model.endswith("2.0") else 1)


def pair(*starts: float) -> Host:
    joints = [Joint(f"j{number}", number, "XM430-W210", start=start) for number, start in enumerate(starts, 1)]
    return Host(joints, 2)


@pytest.fixture(params=["MX-64", "XM430-W350"])
def host(request: pytest.FixtureRequest) -> Host:
    return one(request.param)


def fault(host: Host, kind: str, servo: int = 0, **more: Any) -> None:
    host.bus.faults.add(Fault(kind, servo, **more), host.now)  # type: ignore[arg-type]  # the names are literals
    host.wait(0)


# The e-manual's own examples (https://emanual.robotis.com/docs/en/dxl/protocol1/, .../protocol2/)


def test_protocol_1_answers_as_the_manual_says() -> None:
    host = one("MX-28")
    assert host.say(bytes.fromhex("FF FF 01 02 01 FB")) == bytes.fromhex("FF FF 01 02 00 FC")
    assert host.say(bytes.fromhex("FF FF 01 04 02 2B 01 CC")) == bytes.fromhex("FF FF 01 03 00 19 E2")  # 25 °C
    assert host.say(bytes.fromhex("FF FF FE 04 03 03 01 F6")) == b""  # nobody answers a broadcast
    assert host.say(bytes.fromhex("FF FF 01 04 02 2B 01 CD")) == b""  # a wrong checksum


def test_protocol_2_answers_as_the_manual_says() -> None:
    host = pair((166 - 2048) * COUNT, (2079 - 2048) * COUNT)
    for servo in host.bus.servos:
        servo.memory["firmware_version"] = 38
    answer = host.say(bytes.fromhex("FF FF FD 00 01 03 00 01 19 4E"))
    assert answer == bytes.fromhex("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D")
    both = host.say(bytes.fromhex("FF FF FD 00 FE 03 00 01 31 42"))
    assert both == answer + bytes.fromhex("FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D")
    read = host.say(bytes.fromhex("FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"))
    assert read == bytes.fromhex("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0") + bytes.fromhex(
        "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE"
    )


# Rules


def test_what_is_kept_without_power_is_locked_while_torque_is_on(host: Host) -> None:
    name = "cw_angle_limit" if host.codec.protocol == 1 else "min_position_limit"
    assert host.write(1, name, 100) == 0
    assert host.write(1, "torque_enable", 1) == 0
    assert host.write(1, name, 200) == (0x08 if host.codec.protocol == 1 else 7)
    assert host.write(1, "torque_enable", 0) == 0
    assert host.read(1, name) == 100


def test_a_write_that_is_refused_changes_nothing(host: Host) -> None:
    first = host.codec.protocol == 1
    before = host.read(1, "goal_position")
    assert host.write(1, "goal_position", 5000) == (0x08 if first else 6)
    assert host.write(1, "present_temperature", 5) == (0x08 if first else 7)
    assert host.write(1, "led", 2) == (0x08 if first else 4)
    (answer,) = host.ask(Request(1, 0x77))
    assert answer.error == (0x40 if first else 2)
    (answer,) = host.ask(host.codec.read(Span(1, 250, 4)))
    assert (answer.error, answer.parameters) == (0x08 if first else 4, b"")
    assert host.read(1, "goal_position") == before


def test_angle_limits_bound_goals_in_protocol_1() -> None:
    host = one("MX-28")
    assert host.write(1, "ccw_angle_limit", 3000) == 0
    assert host.write(1, "goal_position", 3001) == 0x02
    assert host.read(1, "torque_enable") == 0
    assert host.write(1, "goal_position", 3000) == 0


def test_a_goal_switches_torque_on_in_protocol_1_alone(host: Host) -> None:
    assert host.write(1, "goal_position", 2500) == 0
    host.wait(3 * second)
    first = host.codec.protocol == 1
    assert host.read(1, "torque_enable") == int(first)
    assert abs(host.read(1, "present_position") - (2500 if first else 2048)) <= 1


def test_a_registered_write_waits_for_its_action(host: Host) -> None:
    register = host.bus.servo(1).model.registers["goal_position"]
    host.write(1, "torque_enable", 1)
    (answer,) = host.ask(host.codec.write(Write(1, register.address, pack(register, 2100)), registered=True))
    assert (answer.error, host.read(1, "registered"), host.read(1, "goal_position")) == (0, 1, 2048)
    assert host.ask(Request(BROADCAST, Instruction.ACTION)) == []
    assert (host.read(1, "registered"), host.read(1, "goal_position")) == (0, 2100)


def test_how_much_is_answered_is_set_by_the_status_return_level(host: Host) -> None:
    host.write(1, "status_return_level", 1)
    assert host.write(1, "led", 1) == -1
    assert host.read(1, "led") == 1
    host.ask(host.codec.write(Write(1, host.bus.servo(1).model.registers["status_return_level"].address, b"\0")))
    assert host.ask(host.codec.read(Span(1, 0, 2))) == []
    assert len(host.ask(Request(1, Instruction.PING))) == 1


@pytest.mark.parametrize(("model", "speed", "count"), [("MX-64", 100, 100 * 0.114), ("XM430-W350", 50, 50 * 0.229)])
def test_it_goes_to_its_goal_at_the_speed_that_is_set(model: str, speed: int, count: float) -> None:
    host = one(model)
    host.write(1, "moving_speed" if model == "MX-64" else "profile_velocity", speed)
    host.write(1, "torque_enable", 1)
    host.write(1, "goal_position", 4000)
    host.wait(second)
    assert host.read(1, "moving") == 1
    assert host.read(1, "present_velocity") == speed
    before, then = host.read(1, "present_position"), host.now
    host.wait(second)
    turns = (host.read(1, "present_position") - before) / 4096 / ((host.now - then) / second)
    assert turns * 60 == pytest.approx(count, rel=0.01)


@pytest.mark.parametrize("speed", [0, 1023])
def test_no_servo_is_faster_than_its_motor(speed: int) -> None:
    host = one("MX-64")
    host.write(1, "moving_speed", speed)
    host.write(1, "goal_position", 4000)
    host.wait(250 * ms)
    top = host.bus.servo(1).model.top_speed
    assert host.bus.servo(1).state(host.now).velocity == pytest.approx(top)


def test_a_wheel_turns_either_way_and_its_angle_begins_anew() -> None:
    host = one("MX-28")
    host.write(1, "ccw_angle_limit", 0)
    host.write(1, "torque_enable", 1)
    host.write(1, "goal_velocity", -200)
    host.wait(4 * second)
    assert host.read(1, "present_velocity") == -200
    assert 0 <= host.read(1, "present_position") < 4096
    assert host.bus.servo(1).state(host.now).position < -6.3


def test_torque_mode_pushes() -> None:
    host = one("MX-64")
    host.write(1, "torque_control", 1)
    host.write(1, "torque_enable", 1)
    host.write(1, "goal_torque", -300)
    host.wait(second)
    assert host.read(1, "present_load") == -300
    assert host.read(1, "present_velocity") < 0


# Safety of the servos' own


def test_a_bus_watchdog_stops_the_servo_and_says_so_until_it_is_cleared() -> None:
    host = one("XM430-W350")
    host.write(1, "profile_velocity", 50)
    host.write(1, "torque_enable", 1)
    host.write(1, "goal_position", 4000)
    host.write(1, "bus_watchdog", 5)
    for _ in range(10):  # packets for others keep it quiet, too
        host.wait(60 * ms)
        host.ask(Request(7, Instruction.PING))
    assert host.bus.servo(1).state(host.now).velocity > 0.5
    heard = host.now
    host.wait(97 * ms)
    assert not host.events("bus_watchdog")[1:]
    host.wait(2 * second)
    (stopped,) = [what["time"] for what in host.log if what["event"] == "bus_watchdog" and what["value"] == -1]
    assert 98 * ms <= stopped - heard <= 100 * ms
    assert host.bus.servo(1).state(host.now).velocity == 0.0
    assert host.read(1, "bus_watchdog") == -1
    assert host.write(1, "goal_position", 3000) == 4
    assert host.write(1, "bus_watchdog", 0) == 0
    assert host.write(1, "goal_position", 3000) == 0


def test_a_blocked_servo_latches_its_overload_until_its_torque_limit_is_set_anew() -> None:
    host = one("MX-64")
    host.write(1, "goal_position", 3000)
    fault(host, "blocked", 1)
    host.wait(500 * ms)
    assert host.read(1, "present_load") == 1023
    host.wait(3 * second)
    (answer,) = host.ask(Request(1, Instruction.PING))
    assert answer.error == OVERLOAD
    assert (host.read(1, "torque_limit"), host.read(1, "present_load")) == (0, 0)
    assert host.events("torque_limit") == [(1, 0)]
    host.bus.faults.mend("all", 0, host.now)
    host.write(1, "torque_limit", 1023)
    host.wait(2 * second)
    assert (host.read(1, "present_position"), host.ask(Request(1, Instruction.PING))[0].error) == (3000, 0)


def test_a_hardware_error_alerts_and_keeps_torque_off_until_a_reboot() -> None:
    host = one("XL330-M288")
    host.write(1, "torque_enable", 1)
    fault(host, "overload", 1)
    assert host.ask(Request(1, Instruction.PING))[0].error == 0x80
    assert (host.read(1, "hardware_error"), host.read(1, "torque_enable")) == (OVERLOAD, 0)
    assert host.write(1, "torque_enable", 1) == 0x84
    assert host.ask(Request(1, Instruction.REBOOT))[0].error == 0x80  # the answer comes before
    assert host.ask(Request(1, Instruction.PING)) == []
    host.wait(200 * ms)
    assert host.ask(Request(1, Instruction.PING))[0].error == 0
    assert host.write(1, "torque_enable", 1) == 0


@pytest.mark.parametrize(
    ("kind", "bit", "register"),
    [("overheat", OVERHEATING, "present_temperature"), ("voltage", VOLTAGE, "present_voltage")],
)
def test_heat_and_voltage_are_told_while_they_last(kind: str, bit: int, register: str) -> None:
    host = one("MX-28")
    usual = host.read(1, register)
    fault(host, kind, 1, duration=second)
    assert host.ask(Request(1, Instruction.PING))[0].error == bit
    assert host.read(1, register) != usual
    host.wait(2 * second)
    assert host.ask(Request(1, Instruction.PING))[0].error == 0
    assert host.read(1, register) == usual


def test_the_supply_sags_under_load() -> None:
    host = Host(MINI_BENTO, 2)
    idle = host.read(1, "present_voltage")
    for servo in (2, 4):
        host.write(servo, "torque_enable", 1)
    fault(host, "blocked")
    for servo in (2, 4):
        host.write(servo, "goal_position", 2500)
    host.wait(100 * ms)
    assert host.read(1, "present_voltage") < idle


def test_a_hand_moves_a_limp_joint_only() -> None:
    host = Host(BENTO, 1)
    obey(host.bus, host.now, '{"do": "move", "joint": "elbow", "to": "0.5rad"}')
    host.wait(5 * second)
    told = obey(host.bus, host.now, '{"do": "tell"}')
    assert told is not None
    assert told["joints"]["elbow"]["position"] == pytest.approx(0.5)
    assert host.read(2, "present_position") == pytest.approx(2048 + 0.5 / COUNT, abs=1)
    host.write(2, "torque_enable", 1)
    with pytest.raises(SpecError, match="holds against the hand"):
        obey(host.bus, host.now, '{"do": "move", "joint": "elbow", "to": "0rad"}')


# Groups


def test_a_servo_that_is_silent_ends_a_group_read() -> None:
    for host, fast in ((Host(BENTO, 1), False), (Host(MINI_BENTO, 2), False), (Host(MINI_BENTO, 2), True)):
        spans = [Span(number, 36, 4) for number in range(1, 6)]
        request = PROTOCOL2.fast_sync_read(spans) if fast else host.codec.group_read(spans)
        assert len(host.ask(request)) == (1 if fast else 5)
        missing = [spans[0], Span(9, 36, 4), spans[1]]
        asked = PROTOCOL2.fast_sync_read(missing) if fast else host.codec.group_read(missing)
        assert [status.servo for status in host.ask(asked)] == ([] if fast else [1])
        fault(host, "silent", 3)
        assert [status.servo for status in host.ask(request)] == ([] if fast else [1, 2])


def test_a_fast_read_answers_as_the_slow_one() -> None:
    host = Host(MINI_BENTO, 2)
    alike = [Span(number, 132, 4) for number in range(1, 6)]
    unlike = [Span(number, 64 + number, 10 + number) for number in range(1, 6)]
    for slow, fast, spans in (
        (PROTOCOL2.sync_read(alike), PROTOCOL2.fast_sync_read(alike), alike),
        (PROTOCOL2.group_read(unlike), PROTOCOL2.fast_bulk_read(unlike), unlike),
    ):
        expected = host.ask(slow)
        (together,) = host.ask(fast)
        assert [status.servo for status in expected] == [1, 2, 3, 4, 5]
        assert split_fast(together, spans) == expected


# Faults of the line


@pytest.mark.parametrize("kind", ["corrupt", "truncated", "silent", "babble"])
def test_what_is_spoilt_is_no_answer(host: Host, kind: str) -> None:
    ping = Request(1, Instruction.PING)
    fault(host, kind, duration=second)
    sent = host.say(host.codec.request(ping))
    assert (sent == b"") == (kind == "silent")
    assert host.ask(ping) == []
    host.wait(2 * second)
    assert len(host.ask(ping)) == 1


def test_noise_stands_before_an_answer_and_a_late_one_comes_later(host: Host) -> None:
    ping = host.codec.request(Request(1, Instruction.PING))
    plain = host.say(ping)
    fault(host, "noise", duration=second)
    noisy = host.say(ping)
    assert noisy.endswith(plain)
    assert 1 <= len(noisy) - len(plain) <= 16
    host.wait(2 * second)
    fault(host, "late", delay=7 * ms)
    host.bus.receive(host.now, ping)
    assert host.bus.due() == host.now + 7 * ms


def test_a_fault_befalls_with_its_probability() -> None:
    host = one("MX-28")
    fault(host, "silent", probability=0.3)
    heard = sum(len(host.ask(Request(1, Instruction.PING))) for _ in range(300))
    assert 180 <= heard <= 240  # 210, with a standard deviation of 8


def test_nothing_is_heard_while_the_line_is_full_of_garbage() -> None:
    host = one("MX-28")
    host.write(1, "torque_enable", 1)
    fault(host, "babble", duration=100 * ms)
    assert host.bus.due() is not None
    off = host.codec.request(host.codec.write(Write(1, 24, b"\0")))
    garbage = host.say(off)
    assert len(garbage) > 0
    host.wait(200 * ms)
    assert host.read(1, "torque_enable") == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "is no JSON"),
        ('{"kind": "tired"}', "kind"),
        ('{"kind": "silent", "begin": 3}', "has no unit"),
        ('{"kind": "silent", "probability": 1.5}', "give 0 to 1"),
        ('{"kind": "silent", "servant": 3}', "servant"),
    ],
)
def test_a_fault_that_cannot_be_is_refused(text: str, said: str) -> None:
    with pytest.raises(SpecError, match=said):
        read_fault(text)


@pytest.mark.parametrize("line", ["nonsense", "[]", '{"do": "dance"}', '{"do": "move", "joint": "tail", "to": 0}'])
def test_an_order_that_cannot_be_is_refused_and_changes_nothing(line: str) -> None:
    host = one("MX-28")
    with pytest.raises(SpecError):
        obey(host.bus, host.now, line)


def test_joints_that_cannot_be_are_refused() -> None:
    with pytest.raises(SpecError, match="inertia and friction above 0"):
        Body(friction=0.0)
    with pytest.raises(SpecError, match="elbow cannot be at 2 rad"):
        Joint("elbow", 1, "MX-28", Body(high=1.0), start=2.0)


def test_joints_that_cannot_be_on_one_bus_are_refused() -> None:
    with pytest.raises(SpecError, match="does not speak protocol 2"):
        Host(BENTO, 2)
    with pytest.raises(SpecError, match="do not have 4000000 baud"):
        Host([replace(BENTO[0], baud=4_000_000)], 1)
    with pytest.raises(SpecError, match="no model"):
        one("MX-29")


# Time


@pytest.mark.parametrize("robot", list(ROBOTS))
@settings(max_examples=30)
@given(
    baud=st.sampled_from([57_600, 115_200, 1_000_000, 2_000_000]),
    delay=st.integers(0, 250).map(lambda count: 2 * us * count),
    length=st.integers(1, 30),
)
def test_a_transaction_takes_as_long_as_on_a_true_line(robot: str, baud: int, delay: int, length: int) -> None:
    protocol = max(ROBOTS[robot])
    joints = [replace(joint, baud=baud, return_delay=delay) for joint in ROBOTS[robot][protocol]]
    host = Host(joints, protocol, timing=True)
    request = host.codec.request(host.codec.group_read([Span(number, 10, length) for number in range(1, 6)]))
    began = host.now
    host.bus.receive(began, request, baud)
    arrivals, bytes_ = [], []
    while (due := host.bus.due()) is not None:
        arrivals.append(due)
        bytes_.append(len(host.bus.take(due)))
    assert arrivals[-1] - began == pytest.approx(transaction(len(request), bytes_, baud, delay), abs=10)
    assert arrivals[0] - began == pytest.approx(transaction(len(request), bytes_[:1], baud, delay), abs=10)
    assert len(arrivals) == 5


def test_what_is_written_before_a_read_in_one_go_takes_effect_before_it() -> None:
    host = Host(BENTO, 1, timing=True)
    write = host.codec.request(host.codec.sync_write(30, {1: b"\x00\x09"}))
    read = host.codec.request(host.codec.group_read([Span(1, 30, 2)]))
    began = host.now
    heard = host.say(write + read)
    (answer,) = host.codec.status_decoder().feed(heard)
    assert answer.parameters == b"\x00\x09"
    (written,) = [what["time"] for what in host.log if what["event"] == "goal_position"]
    assert written == began + 10 * len(write) * us


def test_a_request_that_was_cut_short_is_forgotten_after_a_while() -> None:
    host = one("MX-28")
    host.say(bytes.fromhex("FF FF 01 F0 03 19"))  # 240 bytes are to come
    host.wait(second)
    assert len(host.ask(Request(1, Instruction.PING))) == 1


def test_two_who_speak_at_once_are_not_understood() -> None:
    host = Host(BENTO, 1, timing=True)
    ping, led = host.codec.request(Request(1, Instruction.PING)), host.codec.write(Write(1, 25, b"\1"))
    host.bus.receive(host.now, ping)
    host.now += 100 * us  # the answer is on its way
    heard = host.say(host.codec.request(led))
    assert host.codec.status_decoder().feed(heard) == []
    host.wait(50 * ms)
    assert host.read(1, "led") == 0
    assert host.ask(Request(BROADCAST, Instruction.PING)) == []  # five at once, in protocol 1.0


def test_servos_understand_their_own_baud_rate_only() -> None:
    host = one("MX-28", baud=57_600)
    ping = host.codec.request(Request(1, Instruction.PING))
    host.bus.receive(host.now, ping, 1_000_000)
    assert host.bus.due() is None
    host.now += second
    host.bus.receive(host.now, ping, 57_600)
    assert host.bus.due() is not None
