"""What a servo does to its joint, as its control table says."""

from __future__ import annotations

from typing import Literal

from rtagent_drivers.dynamixel.control_table import Model
from rtagent_drivers.dynamixel.emulated.memory import Memory
from rtagent_drivers.dynamixel.steps import LIMP, Approach, Drive, Push, Turn

SWIFT = 40.0
"""Acceleration (rad/s²) of a servo that has no profile set; its torque limits it further."""

OPERATING_MODES: dict[int, Literal["position", "wheel", "torque"]] = {0: "torque", 1: "wheel", 16: "torque"}

LIMITS = {
    1: {"goal_position": ("cw_angle_limit", "ccw_angle_limit")},
    2: {"goal_position": ("min_position_limit", "max_position_limit")},
}
SYMMETRIC_LIMITS = {"goal_velocity": "velocity_limit", "goal_pwm": "pwm_limit", "goal_torque": "current_limit"}


def mode(memory: Memory) -> Literal["position", "wheel", "torque"]:
    """Return the mode that a servo is in."""
    if "operating_mode" in memory:
        return OPERATING_MODES.get(memory["operating_mode"], "position")
    if memory.get("torque_control"):
        return "torque"
    return "position" if memory["cw_angle_limit"] or memory["ccw_angle_limit"] else "wheel"


def drive(memory: Memory, model: Model) -> Drive:
    """Return what the servo does now."""
    limit = memory.si("torque_limit", 1.0)
    if not memory["torque_enable"] or limit == 0.0:
        return LIMP
    surge = memory.si("goal_acceleration") or memory.si("profile_acceleration") or SWIFT
    match mode(memory):
        case "torque":
            return Push(_within(memory.si("goal_torque"), limit), 1.0 / model.top_speed)
        case "wheel":
            return Turn(_within(memory.si("goal_velocity"), model.top_speed), surge, limit)
        case _:
            speed = memory.si("moving_speed") or memory.si("profile_velocity") or model.top_speed
            return Approach(memory.si("goal_position"), min(speed, model.top_speed), surge, limit)


def beyond_limits(memory: Memory, name: str, protocol: int) -> bool:
    """Return whether the register `name` is beyond the limits that the servo keeps for it."""
    if name in LIMITS[protocol] and mode(memory) == "position":
        low, high = LIMITS[protocol][name]
        return not memory[low] <= memory[name] <= memory[high]
    limit = SYMMETRIC_LIMITS.get(name)
    return limit is not None and limit in memory and abs(memory[name]) > memory[limit]


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)
