"""The world of Experiment 2: the joint by hand, the person against stated moments, and what they learn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import inf, sqrt

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import integrate, optimize, stats

from rtagent.clock import ClockName
from rtagent.errors import SpecError
from rtagent.testing import DeviceContract
from rtagent.units import degree, ms, second
from rtagent_drivers.egg import egg
from rtagent_drivers.egg.driver import EggWorld
from rtagent_drivers.egg.participant import Participant, Person, best_deviations
from rtagent_drivers.egg.way import Way

START = 10**15
LIVE = Participant(strategy="live")
EXACT = Participant(spread=1, lag=0, adaptation=0.5)
"""One whose presses scatter by a nanosecond, and who leaves next to no margin."""

PRESSING = st.lists(st.tuples(st.integers(0, 4000), st.sampled_from([0.0, 0.5, 1.0, None])), max_size=6)


class TestEgg(DeviceContract):
    def make_device(self):  # type: ignore[no-untyped-def]  # as a user would write it
        return egg(start=(0, 2 * ms))


class TestEggInVirtualTime(TestEgg):
    clock: ClockName = "virtual"


def world(participant: Participant = LIVE, **settings: float) -> EggWorld:
    """An egg at 1 rad that breaks there, a joint of 10 rad/s² that is let go at once; it could go up to 2 rad."""
    given = {"egg": 1.0, "give": 0.0, "travel": 2.0, "velocity": 1.0, "acceleration": 10.0} | settings
    made = EggWorld(**given, start=(0, 0), participant=participant)  # type: ignore[arg-type]  # floats all
    made.begin(START, np.random.default_rng(0))
    return made


def go(joint: EggWorld, when: int, speed: float) -> None:
    joint.command(START + when * ms, {"hammer_velocity": speed})


def at(joint: EggWorld, when: int) -> tuple[float, float]:
    values = joint.values(START + when * ms)
    return float(values["hammer_position"]), float(values["hammer_velocity"])


# The joint


def test_a_way_by_hand() -> None:
    """To 1 rad/s in 0.1 s and 0.05 rad; at 0.6 s it is at 0.55; told to stop there it rests 0.05 rad further."""
    joint = world()
    go(joint, 0, 1.0)
    assert at(joint, 100) == pytest.approx((0.05, 1.0))
    assert at(joint, 600) == pytest.approx((0.55, 1.0))
    go(joint, 600, 0.0)
    assert at(joint, 650) == pytest.approx((0.55 + 0.05 - 0.0125, 0.5))
    assert at(joint, 700) == at(joint, 9000) == pytest.approx((0.6, 0.0))
    assert at(joint, 600) == pytest.approx((0.55, 1.0)), "the past stays as it was"


def test_a_joint_that_is_not_let_go_yet_waits_for_what_it_was_told() -> None:
    joint = EggWorld(1.0, 0.0, 2.0, 1.0, 10.0, (500 * ms, 500 * ms), LIVE)
    joint.begin(START, np.random.default_rng(0))
    go(joint, 0, 1.0)
    assert at(joint, 500) == (0.0, 0.0)
    assert at(joint, 600) == pytest.approx((0.05, 1.0))


def test_an_egg_breaks_when_the_joint_is_there_and_not_before() -> None:
    """It is there 1.05 s after its start, and 0.2 s later where the egg gives 0.2 rad."""
    for give, breaks in ((0.0, 1050), (0.2, 1250)):
        joint = world(give=give)
        go(joint, 0, 1.0)
        assert not joint.values(START + breaks * ms - 1000)["broken"]
        assert joint.values(START + breaks * ms + 1000)["broken"]
        assert joint.next_change(START + 100 * ms) == pytest.approx(START + breaks * ms, abs=1000)


@given(PRESSING, st.lists(st.integers(0, 4500), min_size=2, max_size=8))
@settings(max_examples=15)
def test_a_way_is_that_of_its_speeds_whenever_one_asks(
    told: Sequence[tuple[int, float | None]], times: Sequence[int]
) -> None:
    """Summed up in steps of 1 ms, as a joint would go whose speed changes by at most 10 rad/s²."""
    joint = world()
    wishes = dict(sorted((when, speed or 0.0) for when, speed in told))
    for when, speed in wishes.items():
        go(joint, when, speed)
    position = velocity = wish = 0.0
    expected = {}
    for now in range(max(times) + 1):
        expected[now] = position
        wish = wishes.get(now, wish)
        change = float(np.clip(wish - velocity, -0.01, 0.01))
        position, velocity = position + (velocity + change / 2) * 1e-3, velocity + change
    for time in times:
        assert at(joint, time)[0] == pytest.approx(min(expected[time], 2.0), abs=2e-5)


@given(PRESSING, st.integers(0, 6000))
@example([(0, 1.0), (788, 0.5)], 985)
@settings(max_examples=30)
def test_nothing_turns_true_before_the_next_change(told: Sequence[tuple[int, float | None]], time: int) -> None:
    joint = world(Participant(spread=30 * ms))
    for when, speed in sorted(told, key=lambda each: each[0]):
        go(joint, when, speed or 0.0)
    now = START + max([time, *(when for when, _ in told)]) * ms
    change = joint.next_change(now)
    until = START + 60 * second if change is None else change - 1
    for flag in ("pressed", "broken"):
        assert joint.values(until)[flag] == joint.values(now)[flag]


def test_a_way_is_saved_and_gone_on_with() -> None:
    joint, other = world(), world()
    go(joint, 0, 1.0)
    other.restore(joint.save())
    for each in (joint, other):
        go(each, 300, 0.0)
    assert at(joint, 350) == at(other, 350) != (0.0, 0.0)


def test_what_is_nowhere_is_never_reached() -> None:
    way = Way(0, 1.0, 2.0)
    assert way.reaches(1.0) is None
    way.turn(0, 1.0)
    assert way.reaches(3.0) is None, "the joint ends before"


# The person


def test_a_person_without_scatter_presses_when_the_joint_is_there() -> None:
    joint = world(EXACT)
    go(joint, 0, 1.0)
    (press,) = joint.stimuli(START, START + 5 * second)
    assert press.time == pytest.approx(START + 1050 * ms, abs=100)
    assert joint.values(press.time)["pressed"]
    assert not joint.values(press.time - 1)["pressed"]


def test_what_people_expect_to_be_late_they_press_sooner() -> None:
    """They reckon with 20 ms; the joint rests 100 ms of its way beyond the egg: half of that is learned."""
    joint = world(replace(EXACT, lag=20 * ms))
    go(joint, 0, 1.0)
    assert joint.next_change(START + 200 * ms) == pytest.approx(START + 1030 * ms, abs=100)
    go(joint, 1100, 0.0)  # at 1.05 rad, and 0.05 rad further
    joint.begin(START + 3 * second, np.random.default_rng(0))
    joint.command(START + 3 * second, {"hammer_velocity": 1.0})
    (press,) = joint.stimuli(START + 3 * second, START + 9 * second)
    assert press.time == pytest.approx(START + 3 * second + (1050 - 20 - 50) * ms, abs=100)


def test_who_saw_nothing_move_learns_nothing() -> None:
    joint = world(EXACT)
    for _ in range(3):
        joint.begin(START, np.random.default_rng(0))
    assert joint.save()["lag"] == 0.0


def test_a_live_person_presses_when_they_do() -> None:
    joint = world()
    go(joint, 0, 1.0)
    assert not joint.stimuli(START, START + 9 * second)
    joint.press(START + 500 * ms)
    joint.press(START + 700 * ms)
    assert [stimulus.time for stimulus in joint.stimuli(START, START + 9 * second)] == [START + 500 * ms]


def errors(participant: Participant, count: int = 20_000) -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.array([participant.error(rng) for _ in range(count)]) / ms


def test_anticipated_presses_are_normal_about_what_is_aimed_at() -> None:
    assert stats.kstest(errors(Participant(spread=35 * ms)), "norm", args=(0, 35)).pvalue > 1e-3


def test_reactions_are_the_sum_of_a_normal_and_an_exponential_part_with_mean_zero() -> None:
    late = errors(Participant(strategy="reacting", reaction_spread=20 * ms, reaction_tail=40 * ms))
    assert stats.kstest(late, "exponnorm", args=(40 / 20, -40, 20)).pvalue > 1e-3
    assert late.mean() == pytest.approx(0.0, abs=1.5)
    assert late.std() == pytest.approx(sqrt(20**2 + 40**2), rel=0.03)
    assert Participant(strategy="reacting").deviation == pytest.approx(sqrt(20**2 + 40**2) * ms)


@pytest.mark.parametrize("scatter", [0.01, 0.03, 0.1, 0.3])
def test_the_best_margin_is_where_the_expected_gain_is_greatest(scatter: float) -> None:
    """The gain is the way gone, in parts of the whole, where the egg is whole; summed up numerically here."""

    def gained(z: float) -> float:
        gain, _ = integrate.quad(
            lambda error: (1 - scatter * (z - error)) * stats.norm.pdf(error), -10, z, limit=200
        )
        return float(gain)

    best = optimize.minimize_scalar(lambda z: -gained(z), bounds=(0, 5), method="bounded").x
    assert best_deviations(scatter) == pytest.approx(best, abs=0.01)


def test_people_leave_a_margin_of_their_own_deviations() -> None:
    """3 % of the way: φ(z) / Φ(z) = 0.03 at z = 2.28; half of it where they are half as cautious."""
    margin = Participant(spread=30 * ms).margin(1 * second)
    assert margin == pytest.approx(2.280 * 30 * ms, rel=1e-3)
    assert Participant(spread=30 * ms, caution=0.5).margin(1 * second) == pytest.approx(margin / 2)


def test_a_lag_is_learned_by_a_fixed_share_until_the_joint_rests_where_it_should() -> None:
    person = Person(Participant(spread=30 * ms, adaptation=0.25))
    margin = person.participant.margin(second)
    lags = []
    for _ in range(30):
        lags.append(person.lag)
        person.saw(80 * ms - person.lag - margin, second)  # what is pressed takes 80 ms to its effect
    assert lags[1] == pytest.approx(20 * ms)
    assert [b - 80 * ms for _, b in pairwise(lags)] == pytest.approx(
        [0.75 * (a - 80 * ms) for a, _ in pairwise(lags)]
    )


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: egg(egg=120 * degree), "between 0 and the end of the travel"),
        (lambda: egg(give=40 * degree), "between 0 and the end of the travel"),
        (lambda: egg(velocity=0.0), "above 0"),
        (lambda: egg(start=(2, 1)), "earliest, latest"),
        (lambda: Participant(spread=0), "spread"),
        (lambda: Participant(caution=-inf), "caution"),
        (lambda: Participant(adaptation=1.5), "adaptation"),
    ],
)
def test_what_makes_no_sense_is_refused(make: object, sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        make()  # type: ignore[operator]  # it can be called
