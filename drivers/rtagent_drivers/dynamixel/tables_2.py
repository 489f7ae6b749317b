"""Control tables of protocol 2.0: the X series, and the MX series with firmware for it.

Indirect addresses are left out. Sources: the models' pages under https://emanual.robotis.com/docs/en/dxl/
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import pi

from rtagent_drivers.dynamixel.control_table import Mode, Model, Register

PAGES = "https://emanual.robotis.com/docs/en/dxl"
RPM = 2 * pi / 60
ANGLE, MIDDLE, TOP = 2 * pi / 4096, 2048, 4095
SPEED = 0.229 * RPM
ACCELERATION = 214.577 * RPM / 60
FULL_PWM = 885

KEPT = partial(Register, writable=True, eeprom=True, low=0)
GAIN = partial(Register, size=2, writable=True, low=0, high=16383)
PLACE = partial(Register, size=4, quantity="position", scale=ANGLE, zero=MIDDLE)
VELOCITY = partial(Register, size=4, quantity="velocity", scale=SPEED)
PWM = partial(Register, size=2, quantity="load", scale=1 / FULL_PWM)
TENTH_VOLT = partial(Register, size=2, quantity="voltage", scale=0.1)


def settings(
    number: int, *, temperature: int, voltage: tuple[int, int], speed: int, lowest: int | None = None
) -> Mapping[str, Register]:
    """Return what is kept without power; limits from the factory in °C, tenths of a volt and counts of speed.

    `lowest` is the least that the limits of voltage can be set to, where that is below the one from the factory.
    """
    limit = partial(TENTH_VOLT, writable=True, eeprom=True, low=lowest or voltage[0], high=voltage[1])
    return {
        "model_number": Register(0, 2, eeprom=True, initial=number),
        "model_information": Register(2, 4, eeprom=True),
        "firmware_version": Register(6, 1, eeprom=True, initial=45),
        "id": KEPT(7, 1, initial=1, high=252),
        "baud_rate": KEPT(8, 1, initial=1, high=7),
        "return_delay": KEPT(9, 1, "time", 2e-6, initial=250, high=254),
        "drive_mode": KEPT(10, 1, high=15),
        "operating_mode": KEPT(11, 1, initial=3, high=16),
        "secondary_id": KEPT(12, 1, initial=255, high=255),
        "protocol_type": KEPT(13, 1, initial=2, high=22),
        "homing_offset": Register(
            20, 4, "position", ANGLE, encoding="signed", writable=True, eeprom=True, low=-1044479, high=1044479
        ),
        "moving_threshold": VELOCITY(24, writable=True, eeprom=True, initial=10, low=0, high=1023),
        "temperature_limit": KEPT(31, 1, "temperature", initial=temperature, high=100),
        "max_voltage_limit": limit(32, initial=voltage[1]),
        "min_voltage_limit": limit(34, initial=voltage[0]),
        "pwm_limit": PWM(36, writable=True, eeprom=True, initial=FULL_PWM, low=0, high=FULL_PWM),
        "velocity_limit": VELOCITY(44, writable=True, eeprom=True, initial=speed, low=0, high=2047),
        "max_position_limit": PLACE(48, writable=True, eeprom=True, initial=TOP, low=0, high=TOP),
        "min_position_limit": PLACE(52, writable=True, eeprom=True, low=0, high=TOP),
        "shutdown": KEPT(63, 1, initial=52, high=255),
    }


STATE: Mapping[str, Register] = {
    "torque_enable": Register(64, 1, writable=True, low=0, high=1),
    "led": Register(65, 1, writable=True, low=0, high=1),
    "status_return_level": Register(68, 1, writable=True, initial=2, low=0, high=2),
    "registered": Register(69, 1),
    "hardware_error": Register(70, 1),
    "feedforward_2nd_gain": GAIN(88),
    "feedforward_1st_gain": GAIN(90),
    # reads -1 once it has stopped the servo; 0 switches it off, and clears that
    "bus_watchdog": Register(98, 1, "time", 0.02, encoding="signed", writable=True, low=0, high=127),
    "goal_pwm": PWM(100, encoding="signed", writable=True, initial=FULL_PWM, low=-FULL_PWM, high=FULL_PWM),
    "goal_velocity": VELOCITY(104, encoding="signed", writable=True, low=-2047, high=2047),
    "profile_acceleration": Register(108, 4, "acceleration", ACCELERATION, writable=True, low=0, high=32767),
    "profile_velocity": VELOCITY(112, writable=True, low=0, high=32767),
    "goal_position": PLACE(116, encoding="signed", writable=True, initial=MIDDLE, low=-1048575, high=1048575),
    "realtime_tick": Register(120, 2, "time", 1e-3),
    "moving": Register(122, 1),
    "moving_status": Register(123, 1),
    "present_pwm": PWM(124, encoding="signed"),
    "present_velocity": VELOCITY(128, encoding="signed"),
    "present_position": PLACE(132, encoding="signed", initial=MIDDLE),
    "velocity_trajectory": VELOCITY(136, encoding="signed"),
    "position_trajectory": PLACE(140, encoding="signed", initial=MIDDLE),
    "present_temperature": Register(146, 1, "temperature", initial=25),
}


def gains(velocity: tuple[int, int], position: tuple[int, int, int]) -> Mapping[str, Register]:
    """Return the gains of the servo's own controllers, from the factory: PI of velocity and PID of position."""
    return {
        "velocity_i_gain": GAIN(76, initial=velocity[1]),
        "velocity_p_gain": GAIN(78, initial=velocity[0]),
        "position_d_gain": GAIN(80, initial=position[2]),
        "position_i_gain": GAIN(82, initial=position[1]),
        "position_p_gain": GAIN(84, initial=position[0]),
    }


ACCELERATION_LIMIT: Mapping[str, Register] = {
    "acceleration_limit": KEPT(40, 4, "acceleration", ACCELERATION, initial=32767, high=32767)
}
XL330_MORE: Mapping[str, Register] = {
    "startup_configuration": KEPT(60, 1, high=3),
    "pwm_slope": Register(62, 1, writable=True, eeprom=True, initial=140, low=1, high=255),
    "shutdown": KEPT(63, 1, initial=53, high=255),
    "present_voltage": TENTH_VOLT(144, initial=50),
}
AT_12_VOLTS: Mapping[str, Register] = {"present_voltage": TENTH_VOLT(144, initial=120)}


def by_current(full: int) -> Mapping[str, Register]:
    """Return the registers of a servo that measures its current, of which `full` counts are the most."""
    current = partial(Register, size=2, quantity="load", scale=1 / full)
    return {
        "current_limit": current(38, writable=True, eeprom=True, initial=full, low=0, high=full),
        "goal_torque": current(102, encoding="signed", writable=True, initial=full, low=-full, high=full),
        "present_load": current(126, encoding="signed"),
    }


BY_PWM: Mapping[str, Register] = {
    "goal_torque": STATE["goal_pwm"],
    "present_load": Register(126, 2, "load", 1e-3, encoding="signed"),
}


def modes(torque: int) -> Mapping[Mode, Mapping[str, int]]:
    """Return what brings a servo into each mode; `torque` is the operating mode for that.

    Drive mode 0: forwards, and profiles in speeds, not in times.
    """
    position = {"operating_mode": 3, "drive_mode": 0}
    return {
        "position": position,
        "velocity": position,
        "wheel": {"operating_mode": 1, "drive_mode": 0},
        "torque": {"operating_mode": torque, "drive_mode": 0},
    }


BY_CURRENT_MODES, BY_PWM_MODES = modes(0), modes(16)

XL330 = partial(settings, temperature=70, voltage=(35, 70), lowest=31)
XM430 = partial(settings, temperature=80, voltage=(95, 160))
MX = partial(settings, temperature=80, voltage=(95, 160))
XM430_STATE = {**STATE, **AT_12_VOLTS, **gains((100, 1920), (800, 0, 0)), **by_current(1193)}
MX_STATE = {**STATE, **AT_12_VOLTS, **ACCELERATION_LIMIT, **gains((100, 1920), (850, 0, 0))}
XL330_STATE = {**STATE, **XL330_MORE, **by_current(1750)}

XL330_M077 = {**XL330(1190, speed=1620), **XL330_STATE, **gains((40, 400), (400, 400, 0))}
XL330_M288 = {**XL330(1200, speed=445), **XL330_STATE, **gains((180, 1600), (400, 0, 0))}
XL430_W250 = {
    **settings(1060, temperature=72, voltage=(60, 140), speed=265),
    **STATE,
    **AT_12_VOLTS,
    **gains((100, 1000), (640, 0, 4000)),
    **BY_PWM,
}
XM430_W210 = {**XM430(1030, speed=330), **XM430_STATE}
XM430_W350 = {**XM430(1020, speed=200), **XM430_STATE}
MX_28 = {**MX(30, speed=230), **MX_STATE, **BY_PWM}
MX_64 = {**MX(311, speed=285), **MX_STATE, **by_current(1941)}
MX_106 = {**MX(321, speed=210), **MX_STATE, **by_current(2047)}

MODELS = (
    Model("MX-28-2.0", 30, 2, f"{PAGES}/mx/mx-28-2/", MX_28, BY_PWM_MODES, 2.5, 55 * RPM),
    Model("MX-64-2.0", 311, 2, f"{PAGES}/mx/mx-64-2/", MX_64, BY_CURRENT_MODES, 6.0, 63 * RPM),
    Model("MX-106-2.0", 321, 2, f"{PAGES}/mx/mx-106-2/", MX_106, BY_CURRENT_MODES, 8.4, 45 * RPM),
    Model("XL330-M077", 1190, 2, f"{PAGES}/x/xl330-m077/", XL330_M077, BY_CURRENT_MODES, 0.215, 383 * RPM, 5.0),
    Model("XL330-M288", 1200, 2, f"{PAGES}/x/xl330-m288/", XL330_M288, BY_CURRENT_MODES, 0.52, 103 * RPM, 5.0),
    Model("XL430-W250", 1060, 2, f"{PAGES}/x/xl430-w250/", XL430_W250, BY_PWM_MODES, 1.5, 61 * RPM),
    Model("XM430-W210", 1030, 2, f"{PAGES}/x/xm430-w210/", XM430_W210, BY_CURRENT_MODES, 3.0, 77 * RPM),
    Model("XM430-W350", 1020, 2, f"{PAGES}/x/xm430-w350/", XM430_W350, BY_CURRENT_MODES, 4.1, 46 * RPM),
)
