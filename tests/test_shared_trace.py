"""Demons that share a trace: the fast form against the plain one, and the plain one against single learners."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import kernels
from rtagent.experience import FeatureVector, Transition
from rtagent.learning import TrueOnlineTD
from rtagent.learning.cumulants import Cumulants, Signal, Within
from rtagent.learning.lazy_trace import LazyTrace, shared_trace
from rtagent.learning.shared_trace import Precision, SharedTrace, Step, TraceGroup

pytestmark = pytest.mark.slow

SIGNALS = 3
NOWHERE = FeatureVector(np.zeros(0, dtype=np.intp))


@dataclass(frozen=True)
class World:
    """A stream of features: `active` of `size`, of which `changing` at most change in a step."""

    size: int = 60
    active: int = 8
    changing: int = 3
    real: bool = False
    lambda_: float = 0.9
    ending: float = 0.03
    zeros: float = 0.0

    def steps(self, count: int, seed: int) -> Iterator[Step]:
        rng = np.random.default_rng(seed)
        here = self._fresh(rng)
        for _ in range(count):
            there = self._next(here, rng)
            ends, terminates = rng.random(2) < self.ending
            gamma = 0.0 if terminates else float(rng.choice([0.9, 0.9, 0.5, 1.0, 0.0]))
            decay = 0.0 if ends or terminates else gamma * self.lambda_
            transition = Transition(here, None, 1.0, 0.0, there, None, 0, bool(terminates), bool(ends))
            yield Step(here, there, rng.random(SIGNALS), 0.3, gamma, decay, bool(ends or terminates), transition)
            lost = rng.random() < self.ending
            here = self._fresh(rng) if lost or ends or terminates else there

    def _fresh(self, rng: np.random.Generator) -> FeatureVector:
        return self._valued(np.sort(rng.permutation(self.size)[: self.active]), rng)

    def _next(self, here: FeatureVector, rng: np.random.Generator) -> FeatureVector:
        leaving = rng.permutation(self.active)[: rng.integers(0, self.changing + 1)]
        others = np.setdiff1d(np.arange(self.size), here.indices)
        indices = here.indices.copy()
        indices[leaving] = rng.permutation(others)[: len(leaving)]
        return self._valued(np.sort(indices), rng)

    def _valued(self, indices: np.ndarray, rng: np.random.Generator) -> FeatureVector:
        values = np.where(rng.random(self.active) < self.zeros, 0.0, rng.normal(size=self.active))
        return FeatureVector(indices, values if self.real else None)


def table(demons: int, precision: Precision = "float64") -> Cumulants:
    rng = np.random.default_rng(demons)
    lows = rng.random(demons)
    some = [
        Signal(place % SIGNALS) if place % 2 else Within(place % SIGNALS, lows[place], lows[place] + 0.3)
        for place in range(demons)
    ]
    return Cumulants(some, precision)


def both(world: World, demons: int = 7, precision: Precision = "float64") -> tuple[TraceGroup, TraceGroup]:
    alpha = 0.3 / world.active
    with kernels.plain():
        plain = shared_trace(world.size, table(demons, precision), alpha, precision)
    fast = shared_trace(world.size, table(demons, precision), alpha, precision)
    assert isinstance(plain, SharedTrace)
    assert isinstance(fast, LazyTrace)
    return plain, fast


def learn(group: TraceGroup, step: Step) -> None:
    for _ in group.updating(step):
        pass


def assert_alike(one: np.ndarray, other: np.ndarray, tolerance: float) -> None:
    np.testing.assert_allclose(one, other, rtol=0, atol=tolerance * max(1e-3, np.abs(other).max()))


WORLDS = [
    World(),
    World(changing=8),
    World(lambda_=0.0),
    World(lambda_=1.0, ending=0.0),
    World(real=True),
    World(real=True, changing=8, zeros=0.3, lambda_=0.99),
    World(active=1, changing=1),
]


@pytest.mark.parametrize("world", WORLDS, ids=str)
@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-9), ("float32", 1e-4)])
def test_the_fast_form_predicts_as_the_plain_one_does(world: World, precision: Precision, tolerance: float) -> None:
    plain, fast = both(world, precision=precision)
    rng = np.random.default_rng(5)
    for number, step in enumerate(world.steps(1500, seed=3)):
        learn(plain, step)
        learn(fast, step)
        assert_alike(fast.estimate, plain.estimate, tolerance)
        if number % 100 == 0:
            elsewhere = world._fresh(rng)
            assert_alike(fast.predict(elsewhere), plain.predict(elsewhere), tolerance)
            assert_alike(fast.weights, plain.weights, tolerance)


def test_predictions_stay_the_same_over_100_000_steps() -> None:
    world = World(size=30, active=5, ending=0.001, lambda_=0.95)
    plain, exact = both(world, demons=3)
    _, short = both(world, demons=3, precision="float32")
    largest = 1e-3
    steps = list(world.steps(5_000, seed=6))
    for step in steps * 20:
        for group in (plain, exact, short):
            learn(group, step)
        largest = max(largest, float(np.abs(plain.estimate).max()))
        assert np.abs(exact.estimate - plain.estimate).max() <= 1e-9 * largest
        assert np.abs(short.estimate - plain.estimate).max() <= 1e-4 * largest


@settings(max_examples=40)
@given(
    st.integers(0, 10**6), st.integers(1, 8), st.booleans(), st.sampled_from([0.0, 0.5, 0.95, 1.0]),
    st.sampled_from([0.0, 0.1, 0.5]),
)  # fmt: skip
def test_any_stream_gives_the_same(seed: int, changing: int, real: bool, lambda_: float, ending: float) -> None:
    world = World(changing=changing, real=real, lambda_=lambda_, ending=ending, zeros=0.2)
    plain, fast = both(world)
    for step in world.steps(120, seed):
        learn(plain, step)
        learn(fast, step)
    assert_alike(fast.weights, plain.weights, 1e-9)


@pytest.mark.parametrize("world", [World(), World(real=True)], ids=str)
def test_each_demon_learns_what_a_learner_of_its_own_does(world: World) -> None:
    """An independent form: one object a demon, with the reward and the trace of its own."""
    plain, fast = both(world, demons=4)
    gamma, cumulants = 0.8, table(4)
    alone = [
        TrueOnlineTD(size=world.size, alpha=0.3 / world.active, gamma=gamma, lambda_=world.lambda_)
        for _ in range(4)
    ]
    rewards = np.zeros(4)
    for drawn in world.steps(300, seed=1):
        kept = 0.0 if drawn.transition.terminated else gamma
        step = drawn._replace(gamma=kept, decay=0.0 if drawn.last else kept * world.lambda_)
        if not np.array_equal(step.features.indices, fast._here.indices):
            break  # what follows was not seen by single learners as a cut
        cumulants.fill(step.signals, step.scale, rewards)
        for learner, reward in zip(alone, rewards.tolist(), strict=True):
            t = step.transition
            learner.update(
                Transition(t.features, None, 1.0, reward, t.next_features, None, 0, t.terminated, t.truncated)
            )
        learn(plain, step)
        learn(fast, step)
    expected = np.stack([learner.weights for learner in alone], axis=1)
    assert_alike(plain.weights, expected, 1e-10)
    assert_alike(fast.weights, expected, 1e-9)


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.booleans(), st.sampled_from([0.0, 0.9]))
def test_where_it_is_interrupted_changes_no_bit_and_every_demon_is_before_or_after(
    seed: int, real: bool, lambda_: float
) -> None:
    world = World(real=real, lambda_=lambda_, active=5)
    demons = 200  # so that there are several slices
    straight, interrupted = (shared_trace(world.size, table(demons), 0.05, "float64") for _ in range(2))
    for group in (straight, interrupted):
        group.slice_bytes = 3000  # type: ignore[attr-defined]  # of the fast form
    rng = np.random.default_rng(seed)
    for step in world.steps(40, seed):
        probe = world._fresh(rng)
        before = interrupted.predict(probe)
        learn(straight, step)
        after = straight.predict(probe)
        slices = 0
        for _ in interrupted.updating(step):
            slices += 1
            during = interrupted.predict(probe)
            near = np.minimum(np.abs(during - before), np.abs(during - after))
            assert near.max() <= 1e-9 * max(1e-3, np.abs(after).max())
        assert slices > 1
        assert np.array_equal(interrupted.predict(probe), after)
    assert np.array_equal(straight.weights, interrupted.weights)


@pytest.mark.parametrize("compiled", [True, False])
def test_a_restored_group_goes_on_as_if_nothing_had_been(compiled: bool) -> None:
    world = World(real=True)
    first, second = (both(world)[compiled] for _ in range(2))
    steps = list(world.steps(60, seed=2))
    for step in steps[:30]:
        learn(first, step)
    second.restore(first.save())
    for step in steps[30:]:
        learn(first, step)
        learn(second, step)
    assert np.array_equal(first.weights, second.weights)
    assert np.array_equal(first.estimate, second.estimate)


def test_two_steps_by_hand() -> None:
    """The same two steps as for a single learner: alpha 0.5, gamma 0.5, lambda 1, in fractions of two."""
    a, b = FeatureVector(np.array([0])), FeatureVector(np.array([0, 1]))
    both_rewards = [(1.0, a, b, 0.5, 0.5, False), (2.0, b, a, 0.0, 0.0, True)]
    for group in both(World(size=2, active=1), demons=1):
        rebuilt = type(group)  # alpha differs from that of the worlds
        one = Cumulants([Signal(0)], "float64")
        made = (
            rebuilt(2, one, 0.5, "float64")  # type: ignore[call-arg]
            if rebuilt is SharedTrace
            else LazyTrace(2, one, 0.5, "float64", kernels.load("shared_trace"))  # type: ignore[arg-type]
        )
        for reward, here, there, gamma, decay, last in both_rewards:
            transition = Transition(here, None, 1.0, reward, there, None, 0, last, False)
            learn(made, Step(here, there, np.array([reward]), 1.0, gamma, decay, last, transition))
        assert made.weights[:, 0].tolist() == [1.5, 0.5]


@pytest.mark.parametrize("demons", [1, 511, 512, 513, 1500])
def test_blocks_of_any_size_are_learned_whole(demons: int) -> None:
    world = World()
    plain, fast = both(world, demons)
    for step in world.steps(20, seed=4):
        learn(plain, step)
        learn(fast, step)
    assert_alike(fast.weights, plain.weights, 1e-9)


def test_features_that_may_not_be_written_to_are_taken() -> None:
    world = World(size=4, active=1, changing=1)
    _, fast = both(world)
    for step in world.steps(5, seed=0):
        step.features.indices.setflags(write=False)
        step.next_features.indices.setflags(write=False)
        learn(fast, step)
