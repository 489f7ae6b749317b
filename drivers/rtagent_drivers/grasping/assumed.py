"""What the thesis does not say of its grasping experiment, assumed: each number with its reason.

They are what such devices and people do, and were fixed before anything was learned from them.
"""

from __future__ import annotations

from typing import NamedTuple

from rtagent.units import ms

# The object: "the introduction of the shape" follows the press, and it lies still when the hand closes.
ENTERS_BEFORE, ENTERS_SPREAD = 2000 * ms, 200 * ms
"""How long before the hand closes a stand begins to turn the object in, as a person does it."""
LEAVES_AFTER, LEAVES_SPREAD = 900 * ms, 150 * ms
"""How long after the release it is turned away again: once the hand is open."""
TURNING = 500 * ms
"""How long a turn into the picture takes, and out of it."""

# The hand
CLOSING = 600 * ms
"""How long hobby servos take to close the hand, and to open it."""
FIRST, LAST = (0.0, 0.7), (0.3, 1.0)
"""Over which part of the closing proximal and intermediate joints move: a tendon bends the nearer joint first."""
GRIP, REST = 0.01, 0.003
"""Standard deviations of a joint, closed and open, from trial to trial, in parts of its potentiometer's range."""
DRIFT = 0.008
"""By how much the thumb's distal joint drifts from one recorded trial to the next."""
PRESSING = 0.35
"""What the force sensor in the thumb shows of its range, and by how much more where the thumb has drifted by 1."""


class Joint(NamedTuple):
    """Where a joint is, in parts of its potentiometer's range: open, and closed on a cylinder and on a step."""

    open: float
    cylinder: float
    step: float
    moves: tuple[float, float] = FIRST
    drifts: bool = False


JOINTS = {
    "D0": Joint(0.50, 0.50, 0.50),
    "D1P": Joint(0.15, 0.45, 0.45),
    "D1D": Joint(0.20, 0.50, 0.50, LAST, drifts=True),
    "D2P": Joint(0.08, 0.42, 0.42),
    "D2I": Joint(0.10, 0.50, 0.60, LAST),
    "D3P": Joint(0.08, 0.44, 0.44),
    "D3I": Joint(0.10, 0.52, 0.52, LAST),
    "D4P": Joint(0.08, 0.46, 0.54),
    "D5P": Joint(0.08, 0.55, 0.55),
}
"""The text names those that tell shapes apart (D2I and D4P), one that does not move, and one that drifts."""

# The experimenter's hand
NEUTRAL, DOWN = 0.08, 0.85
"""What a sensor of the glove shows of its range for a finger that is stretched, and put down."""
NEUTRAL_SPREAD, DOWN_SPREAD = 0.02, 0.04
"""Standard deviations from trial to trial, for each finger."""
ANSWERS_AFTER, ANSWER_SPREAD = 500 * ms, 150 * ms
"""When the gesture begins after the hand has begun to close: a choice reaction to what is seen to close."""
RETURNS_AFTER, RETURN_SPREAD = 400 * ms, 120 * ms
"""When the fingers begin to go back after the release."""
APART = 30 * ms
"""Standard deviation of when one finger moves against the others."""
MOVING, MOVING_SPREAD = 400 * ms, 50 * ms
"""How long a finger is under way."""

# What the camera in the palm sees, in parts of the picture's sides, and in 0 to 255
WALL = (8, 8, 8)
THUMB = (150, 150, 160)
GREEN, ORANGE = (40, 170, 60), (230, 120, 20)
LENGTH = 0.8
"""How far an object reaches into the picture from above."""
WIDTH = 0.2
WIDER, NARROWER = 0.25, 0.15
"""The widths of a cylinder, and of the two halves of a stepped one: both cover the same part of the picture."""
SIZE_SPREAD = 0.03
"""Standard deviation of an object's width from trial to trial: it is not turned in to the same place each time."""
THUMB_OPEN, THUMB_ON_CYLINDER, THUMB_ON_STEP = 1 / 6, 0.11, 0.09
"""How far the thumb reaches into the picture; on a step "further out of the frame" than on a cylinder."""
THUMB_TOP, THUMB_BOTTOM = 1 / 3, 2 / 3
LIGHT, FLICKER = 0.01, 0.005
"""Standard deviations of the light: from trial to trial, and how far a frame differs from its neighbours."""
