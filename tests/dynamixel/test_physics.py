"""A joint's motion: a function of time, within its mechanics, against the textbook's formulas."""

from __future__ import annotations

from itertools import pairwise
from math import cos, exp, sin, sqrt

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent.units import ms, second
from rtagent_drivers.dynamixel.physics import AMBIENT, COOLING_TIME, HEATING, Motion, State
from rtagent_drivers.dynamixel.steps import (
    LIMP,
    OVERLOADED_AFTER,
    STICTION,
    Approach,
    Body,
    Drive,
    Hand,
    Push,
    Turn,
)

FASTEST = 6.0
REACH = 2.0

bodies = st.builds(
    Body,
    inertia=st.floats(0.004, 0.06),
    gravity=st.floats(0.0, 0.8),
    friction=st.floats(0.03, 0.1),
    low=st.just(-REACH),
    high=st.just(REACH),
)
places, speeds, surges = st.floats(-3.0, 3.0), st.floats(0.1, FASTEST), st.floats(1.0, 50.0)
drives = st.one_of(
    st.builds(Approach, places, speeds, surges, st.floats(0.2, 1.0)),
    st.builds(Turn, st.floats(-FASTEST, FASTEST), surges, st.floats(0.2, 1.0)),
    st.builds(Push, st.floats(-1.0, 1.0), st.just(1 / FASTEST)),
    st.builds(Hand, places),
    st.just(LIMP),
)
histories = st.lists(st.tuples(st.integers(0, 2 * second), drives, st.booleans()), min_size=1, max_size=5)


def moved(body: Body, history: list[tuple[int, Drive, bool]]) -> tuple[Motion, int]:
    """Return a motion under drives, each so long after the one before; some of the joints are blocked a while."""
    motion, now = Motion(body, 0.5, 0), 0
    for pause, drive, blocked in history:
        now += pause
        motion.block(now, blocked)
        motion.drive(now, drive)
    return motion, now


@settings(max_examples=50)
@given(bodies, histories, st.lists(st.integers(0, 12 * second), min_size=2, max_size=8))
def test_the_order_of_looking_changes_nothing(body: Body, history: list, times: list[int]) -> None:
    motion, last = moved(body, history)
    forwards = {time: motion.at(last + time) for time in sorted(times)}
    motion, _ = moved(body, history)
    assert {time: motion.at(last + time) for time in sorted(times, reverse=True)} == forwards


@given(bodies, histories, st.integers(0, 3 * second))
def test_it_never_jumps_and_stays_between_its_stops(body: Body, history: list, time: int) -> None:
    motion, _ = moved(body, history)
    before, after = motion.at(time), motion.at(time + ms)
    assert abs(after.position - before.position) <= 2 * FASTEST * 1e-3
    assert -REACH - 1e-6 <= after.position <= REACH + 1e-6
    assert abs(after.load) <= 1.0
    assert abs(after.temperature - before.temperature) <= HEATING * 1e-3 / COOLING_TIME + 1e-9


@given(st.floats(-REACH, REACH), speeds, surges)
def test_a_way_takes_as_long_as_the_trapezoid_of_the_textbook(goal: float, speed: float, surge: float) -> None:
    body = Body(inertia=0.001)  # so light that its torque sets no limit
    motion = Motion(body, 0.0, 0, Approach(goal, speed, surge))
    way = abs(goal)
    long_enough = way > speed**2 / surge
    takes = way / speed + speed / surge if long_enough else 2.0 * sqrt(way / surge)
    states = [motion.at(round(takes * part / 20 * second)) for part in range(21)]
    assert max(abs(state.velocity) for state in states) <= speed * (1 + 1e-9)
    assert motion.at(round(takes * second) + 10) == pytest.approx(State(goal, 0.0, 0.0, AMBIENT, False), abs=0.05)
    assert motion.at(round(takes / 2 * second)).position == pytest.approx(goal / 2, abs=1e-6)
    assert motion.at(round(takes * 0.9 * second)).position != goal or way < 1e-6


@given(bodies, speeds, places, st.floats(0.0, 1.0))
def test_it_turns_back_without_a_jump_of_its_velocity(body: Body, speed: float, goal: float, when: float) -> None:
    motion = Motion(body, 0.0, 0, Approach(1.5, speed, 20.0))
    now = round(when * second)
    before = motion.at(now)
    motion.drive(now, Approach(goal, speed, 20.0))
    assert motion.at(now).velocity == pytest.approx(before.velocity)
    assert motion.at(now + ms).velocity == pytest.approx(before.velocity, abs=20.0 * 1e-3 + 1e-6)


@settings(max_examples=30)
@given(bodies, st.floats(-REACH, REACH))
def test_a_limp_arm_only_loses_energy_and_comes_to_rest(body: Body, position: float) -> None:
    motion = Motion(body, position, 0)
    energy = [
        0.5 * body.inertia * state.velocity**2 + body.gravity * sin(state.position)
        for state in (motion.at(time * 80 * ms) for time in range(100))
    ]
    assert all(later <= earlier + 1e-3 for earlier, later in pairwise(energy))
    rest = motion.at(3600 * second)
    assert rest.velocity == rest.load == 0.0
    held = abs(body.gravity * cos(rest.position)) <= STICTION * body.friction
    assert held or abs(rest.position) == pytest.approx(REACH, abs=1e-6)


@given(st.floats(0.2, 0.9), st.integers(1, 1000))
def test_what_holds_a_weight_warms_up_by_the_square_of_its_load(load: float, seconds: int) -> None:
    motion = Motion(Body(gravity=load), 0.0, 0, Turn(0.0, 10.0))
    warmed = AMBIENT + HEATING * load**2 * (1 - exp(-seconds / COOLING_TIME))
    assert motion.at(seconds * second).temperature == pytest.approx(warmed)
    motion.drive(seconds * second, Hand(0.0))
    assert motion.at((seconds + 3600) * second).temperature == pytest.approx(AMBIENT, abs=0.1)


@pytest.mark.parametrize("drive", [Approach(1.0, 2.0, 20.0, limit=0.6), Turn(2.0, 20.0, limit=0.6)])
def test_a_blocked_servo_stands_at_its_torque_limit_until_it_lets_go(drive: Drive) -> None:
    motion = Motion(Body(), 0.0, 0, drive)
    motion.block(100 * ms, True)
    stuck = motion.at(200 * ms)
    lets_go = motion.lets_go()
    assert (stuck.velocity, stuck.load, stuck.overloaded) == (0.0, 0.6, False)
    assert lets_go == 100 * ms + round(OVERLOADED_AFTER * second)
    assert motion.at(lets_go - 1).load == 0.6
    assert motion.at(lets_go + 1)[2:] == (0.0, motion.at(lets_go + 1).temperature, True)
    motion.block(150 * ms, False)
    assert motion.lets_go() is None
    assert motion.at(500 * ms).position > stuck.position


@given(st.floats(0.005, 0.05), st.floats(0.0, 0.5), st.floats(2.0, 8.0))
def test_load_is_what_the_motion_takes(inertia: float, gravity: float, surge: float) -> None:
    body = Body(inertia=inertia, gravity=gravity)
    speeding_up = Motion(body, 0.0, 0, Approach(1.0, 2.0, surge)).at(0)
    assert speeding_up.load == pytest.approx(inertia * surge + gravity)
    holding = Motion(body, 0.7, 0, Approach(0.7, 2.0, surge)).at(second)
    assert holding.load == pytest.approx(gravity * cos(0.7))


def test_a_servo_too_weak_for_its_weight_does_not_move_it() -> None:
    motion = Motion(Body(gravity=0.7), 0.0, 0, Approach(1.0, 1.0, 10.0, limit=0.5))
    assert motion.at(900 * ms).position == 0.0
    assert motion.at(round(OVERLOADED_AFTER * second) + second).position < 0.0


def test_a_wheel_under_torque_reaches_the_speed_at_which_it_is_used_up() -> None:
    motion = Motion(Body(gravity=0.0, friction=0.05), 0.0, 0, Push(0.55, damping=0.1))
    assert motion.at(10 * second).velocity == pytest.approx(5.0, rel=0.01)
    ahead = motion.at(20 * second).position - motion.at(10 * second).position
    assert ahead == pytest.approx(50.0, rel=0.01)
    motion.drive(20 * second, Push(-0.55, damping=0.1))
    assert motion.at(30 * second).velocity == pytest.approx(-5.0, rel=0.01)
