"""What settings of a board are refused, and what follows from those that are taken."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any

import pytest
from boards import FINGERS, SERVOS

from rtagent.errors import SpecError
from rtagent.units import ms, us
from rtagent_drivers.arduino.driver import arduino
from rtagent_drivers.arduino.servos import Ramp, ServoBank
from rtagent_drivers.arduino.settings import Channel, Servo, Settings, value


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"channels": {}}, "name the channels"),
        ({"baud": 115_200}, "does not have 115200 baud exactly: take 250kbaud"),
        ({"baud": 921_600}, "does not have 921600 baud exactly"),
        ({"rate": 2000.0, "baud": 250_000}, "23 bytes × 10 bits × 2000 Hz = 460 kbit/s, too much for 250000 baud"),
        ({"rate": 0.0}, "give how often"),
        ({"channels": {"x": Channel("B1")}}, "'B1' is no pin"),
        ({"channels": {"x": Channel("A1"), "y": Channel("A1")}}, "two channels are on pin A1"),
        ({"channels": {"x": Channel("A1", inverted=True)}}, "swap low and high"),
        ({"servos": {"a": Servo(3), "b": Servo(3)}}, "two servos are on pin 3"),
        ({"servos": {"a": Servo(3)}, "heartbeat": ms}, "give 10ms to 60s"),
        ({"format": "handi", "channels": {"x": Channel("FSR6")}}, "has no 'FSR6'"),
        ({"format": "handi", "servos": {"a": Servo(3)}}, "name those on pins 3, 5, 6, 9, 10, 11"),
        ({"format": "handi", "servos": SERVOS, "stop": "detach"}, "cannot let go"),
        ({"format": "handi", "servos": SERVOS, "stop": "hold"}, "give each a start"),
        ({"format": "glovi", "servos": SERVOS}, "on pins none"),
    ],
)
def test_settings_that_cannot_be_are_refused_with_a_sentence(settings: Mapping[str, Any], said: str) -> None:
    with pytest.raises(SpecError, match=said.replace("(", r"\(")):
        arduino(**{"port": "x", "channels": {} if "format" in settings else FINGERS, **settings})


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"pulses": (400 * us, 2000 * us)}, "within 500 µs to 2.4 ms"),
        ({"pulses": (1500 * us, 1500 * us)}, "two that differ"),
        ({"range": (1.0, 1.0)}, "least, greatest"),
        ({"low": 2.0, "high": 1.0}, "nothing is left"),
        ({"high": 4.0}, "nothing is left"),
        ({"low": 1.0, "start": 0.5}, "start is 0.5 rad, outside"),
        ({"max_velocity": -1.0}, "negative"),
    ],
)
def test_servos_that_cannot_be_are_refused_with_a_sentence(settings: Mapping[str, Any], said: str) -> None:
    with pytest.raises(SpecError, match=said):
        Servo(3, **settings)


def test_native_usb_takes_any_rate() -> None:
    assert Settings("x", baud="usb", channels=FINGERS, rate=2000.0).period == 500 * us


def test_readings_mean_what_the_channel_says() -> None:
    assert value(Channel(low=-1.0, high=3.0), "A0", 0) == -1.0
    assert value(Channel(low=3.0, high=-1.0), "A0", 1023) == -1.0
    assert value(Channel(), "2", 1) is True
    assert value(Channel(inverted=True), "2", 1) is False
    assert arduino(port="x", format="handi").spec.sensors["M"].dtype == "bool"


def test_pulses_belong_to_angles() -> None:
    servo = Servo(3, range=(-pi / 2, pi / 2), pulses=(2000 * us, 1000 * us))
    assert [servo.pulse(angle) for angle in (-pi / 2, 0.0, pi / 2)] == [2000, 1500, 1000]


def test_a_ramp_is_no_faster_than_it_may_be_and_turns_round_where_it_is() -> None:
    ramp = Ramp(Servo(3, start=0.0, max_velocity=2.0, high=3.0))
    assert ramp.go(9.0, 0) == 3.0
    assert [ramp.at(time * ms) for time in (0, 500, 1500, 9000)] == [0.0, 1.0, 3.0, 3.0]
    assert ramp.go(0.0, 1000 * ms) == 0.0
    assert [ramp.at(time * ms) for time in (1000, 1500, 2000)] == [2.0, 1.0, 0.0]
    ramp.stay(1500 * ms)
    assert ramp.at(9000 * ms) == 1.0


def test_a_legacy_hand_is_told_of_all_its_servos_in_the_order_of_its_pins() -> None:
    servos = {f"s{pin}": Servo(pin, start=pi * pin / 18) for pin in (11, 3, 5, 6, 9, 10)}
    bank = ServoBank(servos, (3, 5, 6, 9, 10, 11), legacy=True)
    assert bank.said(0) == b""
    bank.go("s5", pi, 0)
    assert bank.said(0) == b"30,180,60,90,100,110."
