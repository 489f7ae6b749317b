"""Control tables, units, and what servos complain of."""

from __future__ import annotations

from math import inf, nan, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtagent.errors import SpecError
from rtagent_drivers.dynamixel import faults, values
from rtagent_drivers.dynamixel.models import MODELS, Model, Register, by_name, by_number

EVERY = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())
IN_EVERY = {
    "model_number", "firmware_version", "id", "baud_rate", "return_delay", "status_return_level", "shutdown",
    "temperature_limit", "min_voltage_limit", "max_voltage_limit", "torque_enable", "led", "goal_position",
    "moving", "present_position", "present_velocity", "present_load", "present_voltage",
    "present_temperature", "registered",
}  # fmt: skip
VIEWS = {"goal_velocity", "goal_torque"}
"""Names that may stand for a place that has another name too."""

MX_64, XL330, XL430 = by_name("MX-64").registers, by_name("XL330-M288").registers, by_name("XL430-W250").registers


@EVERY
def test_every_model_has_what_a_driver_needs(model: Model) -> None:
    assert set(model.registers) >= IN_EVERY
    assert model.registers["model_number"].initial == model.number
    assert {"moving_speed"} & set(model.registers) if model.protocol == 1 else "profile_velocity" in model.registers
    assert ("bus_watchdog" in model.registers) == (model.protocol == 2)
    assert model.source.startswith("https://emanual.robotis.com/docs/en/dxl/")
    assert {"position", "velocity"} <= set(model.modes)
    assert model.stall_torque > 0
    assert model.top_speed > 0


@EVERY
def test_modes_write_what_the_servo_takes(model: Model) -> None:
    needs = {
        "position": "goal_position",
        "velocity": "goal_position",
        "wheel": "goal_velocity",
        "torque": "goal_torque",
    }
    for mode, written in model.modes.items():
        assert needs[mode] in model.registers
        for name, raw in written.items():
            register = model.registers[name]
            assert register.writable
            low, high = values.bounds(register)
            assert low <= raw <= high


@EVERY
def test_registers_do_not_overlap(model: Model) -> None:
    taken: dict[int, str] = {}
    for name, register in model.registers.items():
        if name in VIEWS:
            continue
        for address in range(register.address, register.address + register.size):
            assert address not in taken, (name, taken[address])
            taken[address] = name


@EVERY
def test_every_register_holds_what_it_has_from_the_factory(model: Model) -> None:
    for register in model.registers.values():
        low, high = values.bounds(register)
        assert low <= register.initial <= high
        assert values.unpack(register, values.pack(register, register.initial)) == register.initial
        assert register.writable or not register.eeprom or register.address < 8


@EVERY
def test_a_servo_is_in_the_middle_at_zero(model: Model) -> None:
    register = model.registers["present_position"]
    assert values.to_si(register, model.registers["goal_position"].initial) == 0
    assert model.counts_per_turn in (4096, 1228)


def test_what_is_read_together_stands_together() -> None:
    """The spans of devices that are read in every cycle: 8 bytes from 36 in 1.0, 21 from 126 in 2.0."""
    for model in MODELS.values():
        start, length = (36, 8) if model.protocol == 1 else (126, 21)
        for name in ("position", "velocity", "load", "voltage", "temperature"):
            register = model.registers[f"present_{name}"]
            assert start <= register.address
            assert register.address + register.size <= start + length


REGISTERS = [(model.name, name) for model in MODELS.values() for name in model.registers]


@given(st.sampled_from(REGISTERS), st.data())
def test_every_count_survives_bytes_and_units(which: tuple[str, str], data: st.DataObject) -> None:
    register = MODELS[which[0]].registers[which[1]]
    raw = data.draw(st.integers(*values.bounds(register)))
    packed = values.pack(register, raw)
    assert len(packed) == register.size
    assert values.unpack(register, b"\xaa" + packed + b"\xaa", 1) == raw
    assert values.to_raw(register, values.to_si(register, raw)) == raw


@pytest.mark.parametrize(
    ("register", "raw", "si"),
    [
        (MX_64["present_position"], 2048, 0.0),
        (MX_64["present_position"], 3072, pi / 2),
        (MX_64["present_velocity"], 300, 34.2 * 2 * pi / 60),
        (MX_64["present_velocity"], -300, -34.2 * 2 * pi / 60),
        (MX_64["present_load"], -1023, -1.0),
        (MX_64["present_voltage"], 119, 11.9),
        (MX_64["present_current"], 2148, 0.45),
        (MX_64["return_delay"], 250, 500e-6),
        (XL330["present_position"], 1024, -pi / 2),
        (XL330["goal_velocity"], -100, -22.9 * 2 * pi / 60),
        (XL330["goal_torque"], 875, 0.5),
        (XL330["bus_watchdog"], 5, 0.1),
        (XL330["profile_acceleration"], 1, 214.577 * 2 * pi / 3600),
        (XL430["present_load"], -500, -0.5),
        (by_name("AX-12A").registers["goal_position"], 1023, 511 * 300 / 1023 * pi / 180),
    ],
)
def test_units_are_those_of_the_manual(register: Register, raw: int, si: float) -> None:
    assert values.to_si(register, raw) == pytest.approx(si, abs=1e-9)
    assert values.to_raw(register, si) == raw


@pytest.mark.parametrize(
    ("register", "raw", "data"),
    [
        (MX_64["present_load"], -5, "0504"),
        (MX_64["present_load"], 5, "0500"),
        (MX_64["goal_velocity"], -1023, "ff07"),
        (XL330["goal_torque"], -1, "ffff"),
        (XL330["present_position"], -2, "feffffff"),
        (XL330["bus_watchdog"], -1, "ff"),
    ],
)
def test_signs_are_as_each_protocol_writes_them(register: Register, raw: int, data: str) -> None:
    assert values.pack(register, raw) == bytes.fromhex(data)
    assert values.unpack(register, bytes.fromhex(data)) == raw


def test_a_zero_with_a_sign_is_a_zero() -> None:
    assert values.unpack(MX_64["present_velocity"], b"\x00\x04") == 0


@pytest.mark.parametrize(
    ("register", "value"),
    [(MX_64["goal_position"], 3.2), (MX_64["moving_speed"], -1.0), (XL330["goal_torque"], 1.01), (XL330["id"], nan),
     (XL330["goal_velocity"], inf)],
)  # fmt: skip
def test_what_a_register_cannot_hold_has_a_sentence(register: Register, value: float) -> None:
    with pytest.raises(SpecError, match="it takes"):
        values.to_raw(register, value)


def test_counts_and_bytes_that_do_not_fit_have_a_sentence() -> None:
    with pytest.raises(SpecError, match="it holds 0 to 65535"):
        values.pack(MX_64["goal_position"], -1)
    with pytest.raises(SpecError, match="4 bytes end before"):
        values.unpack(XL330["present_position"], bytes(4), 2)


@pytest.mark.parametrize("register", [MX_64["moving_speed"], XL330["profile_velocity"]])
def test_slow_is_never_sent_as_zero_which_means_as_fast_as_it_goes(register: Register) -> None:
    assert values.speed_to_raw(register, 1e-9) == 1
    assert values.speed_to_raw(register, 1.0) == values.to_raw(register, 1.0)
    for speed in (0.0, -0.1, nan):
        with pytest.raises(SpecError, match="as fast as it goes"):
            values.speed_to_raw(register, speed)


def test_baud_rates() -> None:
    assert [values.baud_rate(1, raw) for raw in (1, 34, 250, 252)] == [1_000_000, 57_142, 2_250_000, 3_000_000]
    assert [values.baud_rate(2, raw) for raw in (1, 3, 6)] == [57_600, 1_000_000, 4_000_000]
    for protocol, raw in ((1, 255), (2, 8), (3, 1)):
        with pytest.raises(SpecError, match="means no baud rate"):
            values.baud_rate(protocol, raw)


def test_models_are_found_by_name_and_number() -> None:
    assert [model.name for model in by_number(310, 1)] == ["MX-64"]
    assert [model.name for model in by_number(1200, 2)] == ["XL330-M288"]
    assert by_number(310, 2) == []
    with pytest.raises(SpecError, match="did you mean 'MX-64'"):
        by_name("MX64")


def test_the_manuals_example_of_an_error_is_overload_and_heat() -> None:
    assert faults.sentences(1, 0x24) == [faults.HOT, faults.OVERLOAD]
    assert faults.is_grave(1, 0x24)


def test_a_torque_limit_of_zero_is_a_latched_overload() -> None:
    assert faults.sentences(1, 0, torque_limit=0) == [faults.OVERLOAD]
    assert faults.sentences(1, 0x20, torque_limit=0) == [faults.OVERLOAD]
    assert faults.sentences(1, 0, torque_limit=1023) == []
    assert faults.is_grave(1, 0, torque_limit=0)


def test_an_alert_of_protocol_2_tells_to_look_at_the_hardware_error() -> None:
    assert "hardware_error" in faults.sentences(2, 0x80)[0]
    assert faults.sentences(2, 0x80, 0x20) == [faults.OVERLOAD]
    assert faults.sentences(2, 0x87, 0x01)[0].startswith("refuses access")
    assert faults.is_grave(2, 0, 0x20)
    assert not faults.is_grave(2, 7)


@pytest.mark.parametrize("protocol", [1, 2])
def test_every_error_has_sentences_and_none_is_without_a_cure(protocol: int) -> None:
    assert faults.sentences(protocol, 0) == []
    for error in range(1, 256):
        for found in (faults.sentences(protocol, error), faults.sentences(2, 0, error)):
            assert found
            assert all(sentence.endswith(".") and ": " in sentence for sentence in found)
