"""Settings, limits, orders and readings of joints: no line, no loop."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtagent.errors import SpecError
from rtagent.units import ms, second
from rtagent_drivers.dynamixel.calibration import read_calibration, write_calibration
from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.control_table import Mode, Register
from rtagent_drivers.dynamixel.layout import Layout
from rtagent_drivers.dynamixel.limits import LOAD_PATIENCE, Reading
from rtagent_drivers.dynamixel.models import MODELS
from rtagent_drivers.dynamixel.orders import (
    STATE,
    Order,
    reads_in_groups,
    stay,
    switch,
    sync_writes,
    towards,
    turning,
    unwatch,
)
from rtagent_drivers.dynamixel.servo import Servo
from rtagent_drivers.dynamixel.settings import Axis, Joint, Placing, axes, device_spec
from rtagent_drivers.dynamixel.values import pack, to_si, unpack

MX_28, XL_330 = MODELS["MX-28"], MODELS["XL330-M288"]
REST = Reading(0.0, 0.0, 0.0, 25.0, 12.0)


def axis(mode: Mode = "position", model: str = "MX-28", protocol: int = 1, **settings: object) -> Axis:
    joint = Joint(id=1, model=model, mode=mode, **settings)  # type: ignore[arg-type]
    return axes({"wrist": joint}, protocol, {})[0]


def servo(*arguments: object, **settings: object) -> Servo:
    its = axis(*arguments, **settings)  # type: ignore[arg-type]
    made = Servo(its, device_spec([its], 50.0).actuators[its.actuator])
    made.reading, made.on = REST, True
    return made


# Orders, against bytes worked out by hand from the e-manual's control tables


def test_a_goal_of_an_mx_1_is_position_and_speed_side_by_side() -> None:
    order = towards(MX_28, pi / 2, 57 * 0.114 * 2 * pi / 60)
    assert order == Order(30, (2048 + 1024).to_bytes(2, "little") + (57).to_bytes(2, "little"))


def test_a_goal_of_an_xl330_is_profile_velocity_and_position_side_by_side() -> None:
    order = towards(XL_330, -pi / 2, 10 * 0.229 * 2 * pi / 60)
    assert order == Order(112, (10).to_bytes(4, "little") + (2048 - 1024).to_bytes(4, "little"))


def test_a_wheel_of_1_0_has_its_sign_in_bit_10_and_one_of_2_0_counts_below_0() -> None:
    assert turning(MX_28, -100 * 0.114 * 2 * pi / 60) == Order(32, (1024 | 100).to_bytes(2, "little"))
    assert turning(XL_330, -100 * 0.229 * 2 * pi / 60) == Order(104, (-100).to_bytes(4, "little", signed=True))


def test_torque_and_bus_watchdog_stand_where_the_manual_says() -> None:
    assert switch(MX_28, on=True) == Order(24, b"\1")
    assert switch(XL_330, on=False) == Order(64, b"\0")
    assert unwatch(MX_28) is None
    assert unwatch(XL_330) == Order(98, b"\0")


def test_servos_that_are_told_alike_share_a_sync_write() -> None:
    orders = {1: switch(MX_28, on=True), 2: switch(MX_28, on=False), 3: stay(MX_28, "position", 0.0)}
    requests = list(sync_writes(codec(1), orders))
    assert [request.parameters[:2] for request in requests] == [b"\x18\x01", b"\x1e\x04"]
    assert requests[0].parameters[2:] == b"\1\1\2\0"


def test_only_the_ax_series_is_read_one_by_one() -> None:
    assert {model.name for model in MODELS.values() if not reads_in_groups(model)} == {"AX-12A", "AX-18A"}


@given(st.floats(-20.0, 20.0), st.sampled_from([("MX-28", 1), ("XL330-M288", 2), ("AX-12A", 1)]))
def test_no_velocity_is_ever_sent_as_the_0_that_means_full_speed(velocity: float, model: tuple[str, int]) -> None:
    its = servo("velocity", model[0], model[1], low=-1.0, high=1.0)
    told = its.told(velocity, 0)
    speed = its.model.registers["moving_speed" if model[1] == 1 else "profile_velocity"]
    assert unpack(speed, told.order.data, speed.address - told.order.address) >= 1
    goal = its.model.registers["goal_position"]
    angle = to_si(goal, unpack(goal, told.order.data, goal.address - told.order.address))
    towards_limit = 1.0 if told.value > 0 else -1.0 if told.value < 0 else 0.0
    assert angle == pytest.approx(towards_limit, abs=0.006)
    assert (
        told.value == 0.0
        or abs(told.value - max(min(velocity, its.axis.max_velocity), -its.axis.max_velocity)) < 0.013
    )


# Limits


@given(st.lists(st.tuples(st.floats(-30, 30), st.integers(0, 300 * ms)), min_size=1, max_size=20))
def test_velocity_changes_no_faster_than_its_acceleration(commands: list[tuple[float, int]]) -> None:
    its = servo("wheel", max_velocity=2.0, max_acceleration=5.0)
    before, now = 0.0, second
    its.limits.limit(0.0, now, None)
    for value, pause in commands:
        now += pause
        limited = its.limits.limit(value, now, None)
        assert abs(limited) <= 2.0
        assert abs(limited - before) <= 5.0 * min(pause, 100 * ms) / second + 1e-9
        before = limited


def test_a_stop_that_is_told_again_aims_at_the_same_place_until_the_joint_is_told_to_go() -> None:
    """Each from a newer reading, of a joint that still moves: it would never come to rest."""
    its = servo("velocity", low=-1.0, high=1.0)

    def told(now: int, position: float, value: float) -> Order:
        its.reading, its.read_at = REST._replace(position=position, velocity=0.5), now
        return its.told(value, now).order

    first = told(second, 0.1, 0.0)
    assert told(2 * second, 0.2, 0.0) == first
    told(3 * second, 0.3, 0.5)
    assert told(4 * second, 0.3, 0.0) != first


@given(st.floats(allow_nan=False), st.floats(-1.0, 0.9), st.floats(0.01, 1.0))
def test_a_position_is_sent_within_its_limits(value: float, low: float, span: float) -> None:
    its = servo("position", low=low, high=low + span)
    told = its.told(value, 0)
    assert low <= told.value <= low + span
    assert told.value == pytest.approx(min(max(value, low), low + span), abs=0.0008)


def test_a_wheel_at_its_limit_turns_only_back() -> None:
    its = servo("wheel", low=-1.0, high=1.0)
    beyond = REST._replace(position=1.01)
    assert its.limits.limit(1.0, 0, beyond) == 0.0
    assert its.limits.limit(-1.0, second, beyond) == -1.0


@pytest.mark.parametrize("value", [float("nan"), True, "1", None])
def test_what_is_no_number_is_refused(value: object) -> None:
    with pytest.raises(SpecError, match=r"wrist_position was told .*: it takes float from"):
        servo().told(value, 0)  # type: ignore[arg-type]


def test_heat_load_and_places_beyond_the_limits_are_told() -> None:
    its = servo("position", low=-1.0, high=1.0, max_load=0.5, max_temperature=60.0)
    violated = its.limits.violated
    assert violated(REST, 0, True) is None
    assert "at 61 °C, above its 60 °C" in str(violated(REST._replace(temperature=61.0), 0, False))
    assert "beyond its limits -1 to 1" in str(violated(REST._replace(position=1.2), 0, True))
    heavy = REST._replace(load=-0.6)
    assert violated(heavy, 0, True) is None
    assert violated(heavy, LOAD_PATIENCE - 1, True) is None
    assert "bears 60% of its full load" in str(violated(heavy, LOAD_PATIENCE, True))
    assert violated(REST, LOAD_PATIENCE, True) is None
    assert violated(heavy, LOAD_PATIENCE + 1, True) is None


def test_a_limp_joint_may_be_anywhere_and_may_start_from_there() -> None:
    its = servo("position", low=-1.0, high=1.0)
    outside = REST._replace(position=2.0)
    assert its.limits.violated(outside, 0, False) is None
    assert its.limits.violated(outside, 0, True) is None  # it was never inside: it is on its way there
    assert its.limits.violated(REST, 0, True) is None
    assert its.limits.violated(outside, 0, True) is not None


# Axes


@given(st.floats(-1.0, 1.0), st.sampled_from([1, -1]), st.floats(-1.5, 1.5))
def test_an_angle_and_a_position_are_each_others_inverse(zero: float, direction: int, position: float) -> None:
    its = axis(zero=zero, direction=direction)
    assert its.position(its.angle(position)) == pytest.approx(position)
    mirrored = replace(its, direction=-direction)
    assert mirrored.position(mirrored.angle(position)) == pytest.approx(position)


def test_a_wheel_is_read_within_one_turn() -> None:
    assert axis("wheel", "XL330-M288", 2).position(5 * pi + 0.1) == pytest.approx(-pi + 0.1)


def test_limits_are_those_of_the_servo_the_calibration_and_the_joint_together() -> None:
    joint = Joint(id=1, model="AX-12A", low=-9.0, high=1.0)
    placed = Placing(zero=0.5, direction=-1, low=-1.2, high=1.2)
    found = axes({"elbow": joint}, 1, {"elbow": placed})[0]
    assert (found.zero, found.direction, found.low, found.high) == (0.5, -1, -1.2, 1.0)
    alone = axes({"elbow": Joint(id=1, model="AX-12A")}, 1, {})[0]
    assert (alone.low, alone.high) == pytest.approx((-150 * pi / 180, 150 * pi / 180), abs=0.01)
    with pytest.raises(SpecError, match="elbow: zero and direction are in the calibration"):
        axes({"elbow": replace(joint, zero=0.1)}, 1, {"elbow": placed})
    with pytest.raises(SpecError, match="the calibration knows a joint 'ebow': did you mean 'elbow'"):
        axes({"elbow": joint}, 1, {"ebow": placed})


# Readings


@given(st.sampled_from(sorted(MODELS)), st.binary(min_size=30, max_size=30))
def test_a_block_is_unpacked_as_its_registers_are(model: str, data: bytes) -> None:
    registers = [MODELS[model].registers[name] for name in STATE]
    layout = Layout(registers)
    data = data[: layout.length]
    one_by_one = [to_si(each, unpack(each, data, each.address - layout.address)) for each in registers]
    assert layout.values(data) == pytest.approx(one_by_one)


def test_a_sign_and_magnitude_is_read_by_its_own_bit() -> None:
    load = Register(40, 2, scale=1 / 1023, encoding="sign_magnitude", bits=11)
    assert Layout([load]).values((1024 | 1023).to_bytes(2, "little")) == [-1.0]
    assert pack(load, -1023) == (1024 | 1023).to_bytes(2, "little")


# Calibration


def test_a_calibration_comes_back_as_it_was_written(tmp_path: Path) -> None:
    placings = {"elbow": Placing(0.25, -1, -1.5, 1.25), "hand": Placing(-0.5, 1, 0.0, 1.0)}
    write_calibration(tmp_path / "arm.toml", placings)
    assert read_calibration(tmp_path / "arm.toml") == placings


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "No such file or directory: make it with `rtagent calibrate`"),
        ("x = ", "is no TOML"),
        ("x = 1", "is no calibration: it has one table for each joint"),
        ("[joints]\nelbow = 1", "elbow: expected a table with zero, direction, low, high"),
        ('[joints.elbow]\nzreo = "1rad"', "there is no key 'zreo': did you mean 'zero'"),
        ('[joints.elbow]\nzero = "1kg"', "'kg' in '1kg' is no unit of angle"),
        ("[joints.elbow]\ndirection = 2", "direction is 2: give 1 or -1"),
    ],
)
def test_a_calibration_that_cannot_be_used_is_told(text: str | None, said: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.toml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(SpecError, match=said):
        read_calibration(file)
