"""Control tables of protocol 1.0: the MX series, with the firmware that it came with, and the AX series.

Sources: the models' pages under https://emanual.robotis.com/docs/en/dxl/
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import pi

from rtagent_drivers.dynamixel.control_table import Mode, Model, Register

PAGES = "https://emanual.robotis.com/docs/en/dxl"
RPM, DEGREE = 2 * pi / 60, pi / 180
FULL = 1023
"""Counts of the full load or torque, and of the highest speed."""

FLAG = partial(Register, size=1, writable=True, low=0, high=1)
KEPT = partial(Register, writable=True, eeprom=True, low=0)
SIGNED = partial(Register, size=2, encoding="sign_magnitude", bits=11)
"""Counterclockwise is positive; the highest bit says clockwise."""
FRACTION = partial(Register, size=2, quantity="load", scale=1 / FULL, low=0, high=FULL, writable=True)
TENTH_VOLT = partial(Register, size=1, quantity="voltage", scale=0.1)


def settings(
    number: int, *, baud: int, temperature: int, voltage: int, torque: int = FULL
) -> Mapping[str, Register]:
    """Return what is kept without power, as from the factory: limits in °C and tenths of a volt."""
    return {
        "model_number": Register(0, 2, eeprom=True, initial=number),
        "firmware_version": Register(2, 1, eeprom=True, initial=40),
        "id": KEPT(3, 1, initial=1, high=253),
        "baud_rate": KEPT(4, 1, initial=baud, high=254),
        "return_delay": KEPT(5, 1, "time", 2e-6, initial=250, high=254),
        "temperature_limit": KEPT(11, 1, "temperature", initial=temperature, high=100),
        "min_voltage_limit": TENTH_VOLT(12, writable=True, eeprom=True, initial=60, low=50, high=250),
        "max_voltage_limit": TENTH_VOLT(13, writable=True, eeprom=True, initial=voltage, low=50, high=250),
        "max_torque": FRACTION(14, eeprom=True, initial=torque),
        "status_return_level": KEPT(16, 1, initial=2, high=2),
        "alarm_led": KEPT(17, 1, initial=36, high=127),
        "shutdown": KEPT(18, 1, initial=36, high=127),
    }


def motion(*, angle: float, counts: int, speed: float, torque: int = FULL) -> Mapping[str, Register]:
    """Return what moves and is sensed; `angle` (rad) and `speed` (rad/s) are those of one count."""
    middle, top = counts // 2, counts - 1
    place = partial(Register, size=2, quantity="position", scale=angle, zero=middle)
    return {
        "cw_angle_limit": place(6, writable=True, eeprom=True, low=0, high=top),
        "ccw_angle_limit": place(8, writable=True, eeprom=True, initial=top, low=0, high=top),
        "torque_enable": FLAG(24),
        "led": FLAG(25),
        "goal_position": place(30, writable=True, initial=middle, low=0, high=top),
        "moving_speed": Register(32, 2, "velocity", speed, writable=True, low=0, high=FULL),
        "torque_limit": FRACTION(34, initial=torque),
        "present_position": place(36, initial=middle, encoding="signed"),
        "present_velocity": SIGNED(38, quantity="velocity", scale=speed),
        "present_load": SIGNED(40, quantity="load", scale=1 / FULL),
        "present_voltage": TENTH_VOLT(42, initial=120),
        "present_temperature": Register(43, 1, "temperature", initial=25),
        "registered": Register(44, 1),
        "moving": Register(46, 1),
        "lock": FLAG(47),
    }


MX_MOTION = motion(angle=2 * pi / 4096, counts=4096, speed=0.114 * RPM)
AX = partial(motion, angle=300 * DEGREE / 1023, counts=1024, speed=0.111 * RPM)

MX_MORE: Mapping[str, Register] = {
    "goal_velocity": SIGNED(32, quantity="velocity", scale=0.114 * RPM, writable=True),
    "multi_turn_offset": Register(20, 2, encoding="signed", writable=True, eeprom=True, low=-24576, high=24576),
    "resolution_divider": KEPT(22, 1, initial=1, high=4),
    "d_gain": Register(26, 1, writable=True, high=254),
    "i_gain": Register(27, 1, writable=True, high=254),
    "p_gain": Register(28, 1, writable=True, initial=32, high=254),
    "punch": Register(48, 2, writable=True, high=FULL),
    "realtime_tick": Register(50, 2, "time", 1e-3),
    "goal_acceleration": Register(73, 1, "acceleration", 8.583 * DEGREE, writable=True, high=254),
}
MX_TORQUE: Mapping[str, Register] = {
    "present_current": Register(68, 2, "current", 4.5e-3, zero=2048, initial=2048),
    "torque_control": FLAG(70),
    "goal_torque": SIGNED(71, quantity="load", scale=1 / FULL, writable=True),
}
AX_MORE: Mapping[str, Register] = {
    "cw_compliance_margin": Register(26, 1, writable=True, initial=1, high=255),
    "ccw_compliance_margin": Register(27, 1, writable=True, initial=1, high=255),
    "cw_compliance_slope": Register(28, 1, writable=True, initial=32, high=254),
    "ccw_compliance_slope": Register(29, 1, writable=True, initial=32, high=254),
    "punch": Register(48, 2, writable=True, initial=32, low=32, high=FULL),
}


JOINT = {"cw_angle_limit": 0, "ccw_angle_limit": 4095}
WHEEL = {"cw_angle_limit": 0, "ccw_angle_limit": 0}
MX_28_MODES: Mapping[Mode, Mapping[str, int]] = {"position": JOINT, "velocity": JOINT, "wheel": WHEEL}
MX_MODES: Mapping[Mode, Mapping[str, int]] = {
    **{mode: {**written, "torque_control": 0} for mode, written in MX_28_MODES.items()},
    "torque": {"torque_control": 1},
}
# as a wheel it controls no speed: what it takes then is a fraction of its voltage
AX_JOINT = {"cw_angle_limit": 0, "ccw_angle_limit": 1023}
AX_MODES: Mapping[Mode, Mapping[str, int]] = {"position": AX_JOINT, "velocity": AX_JOINT}

MX_SETTINGS = partial(settings, baud=34, temperature=80)
AX_SETTINGS = partial(settings, baud=1, voltage=140)
MX_28 = {**MX_SETTINGS(29, voltage=160), **MX_MOTION, **MX_MORE}
MX_64 = {**MX_SETTINGS(310, voltage=240), **MX_MOTION, **MX_MORE, **MX_TORQUE}
MX_106 = {**MX_SETTINGS(320, voltage=160), **MX_MOTION, **MX_MORE, **MX_TORQUE, "drive_mode": KEPT(10, 1, high=3)}
AX_12A = {**AX_SETTINGS(12, temperature=70), **AX(), **AX_MORE}
AX_18A = {**AX_SETTINGS(18, temperature=75, torque=983), **AX(torque=983), **AX_MORE}

MODELS = (
    Model("MX-28", 29, 1, f"{PAGES}/mx/mx-28/", MX_28, MX_28_MODES, 2.5, 55 * RPM),
    Model("MX-64", 310, 1, f"{PAGES}/mx/mx-64/", MX_64, MX_MODES, 6.0, 63 * RPM),
    Model("MX-106", 320, 1, f"{PAGES}/mx/mx-106/", MX_106, MX_MODES, 8.4, 45 * RPM),
    Model("AX-12A", 12, 1, f"{PAGES}/ax/ax-12a/", AX_12A, AX_MODES, 1.5, 59 * RPM),
    Model("AX-18A", 18, 1, f"{PAGES}/ax/ax-18a/", AX_18A, AX_MODES, 1.8, 97 * RPM),
)
