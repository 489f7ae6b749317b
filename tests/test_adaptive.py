"""Adaptive prototypes: where they go and which, what becomes of their weights, and that nothing else changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import SCENARIOS

from rtagent import Agent, clock, kernels
from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, Move, Outcome, Transition
from rtagent.features import AdaptiveKanerva, Composed, Inputs, Moving, PairedCoder, SelectiveKanerva
from rtagent.learning import (
    GTD,
    TD,
    ExpectedSarsa,
    Horde,
    QLearning,
    Sarsa,
    SwiftTD,
    TrueOnlineSarsa,
    TrueOnlineTD,
)
from rtagent.policy import Greedy
from rtagent.scenario import assemble, load
from rtagent.specs import Spec

STATE = {"x": Spec(low=0.0, high=1.0)}
PLANE = {"x": Spec(low=0.0, high=1.0), "y": Spec(low=-2.0, high=2.0)}
FORMS = {"compiled": nullcontext, "plain": kernels.plain}
ROW = np.array([[0.0], [0.1], [0.2], [0.6], [0.8], [1.0]])
"""Prototypes on a line, a third of which are active."""


def on_a_line(**rules: Any) -> AdaptiveKanerva:
    return AdaptiveKanerva(
        state=STATE, prototypes=ROW, eta=1 / 3, **({"interval": 3, "spacing": 0.05, "rare": 1.0} | rules)
    )


@pytest.mark.parametrize("form", FORMS)
def test_the_least_visited_moves_to_the_state_by_hand(form: str) -> None:
    with FORMS[form]():
        coder = on_a_line()
    assert coder.encode([0.04]).indices.tolist() == [0, 1]
    assert coder.encode([0.85]).indices.tolist() == [4, 5]
    assert coder.take_moves() == ()
    found = coder.encode(
        [0.42]
    )  # 2 and 3 are active, 0.22 and 0.18 away; 0, 1, 4 and 5 have been visited once each
    assert coder.prototypes.ravel().tolist() == [0.42, 0.1, 0.2, 0.6, 0.8, 1.0], "the first of the least visited"
    assert found.indices.tolist() == [0, 3], "2 was the farther one"
    assert coder.take_moves() == (Move(0, 2),)
    assert coder.take_moves() == ()
    assert coder.visits.tolist() == [1, 1, 1, 1, 1, 1]


def test_nothing_moves_before_it_is_due_where_there_is_one_already_and_where_all_are_used() -> None:
    near, used, late = on_a_line(spacing=0.3), on_a_line(rare=0.1), on_a_line(interval=100)
    for coder in (near, used, late):
        for state in [0.0, 0.4, 0.7] * 5:
            coder.encode([state])
    assert near.prototypes.tolist() == late.prototypes.tolist() == ROW.tolist()
    assert used.prototypes.tolist() != ROW.tolist(), "the last was never visited"
    rarest = used.visits.min()
    for state in [0.1, 0.3, 0.5, 0.7, 0.9] * 50:
        used.encode([state])
    assert used.visits.min() > rarest
    before = used.prototypes.copy()
    for state in [0.1, 0.3, 0.5, 0.7, 0.9] * 10:
        used.encode([state])
    assert used.prototypes.tolist() == before.tolist()


@pytest.mark.parametrize("rules", [{"interval": 0}, {"spacing": 0.0}, {"spacing": float("nan")}, {"rare": 1.5}])
def test_rules_that_cannot_be_are_refused(rules: dict[str, Any]) -> None:
    with pytest.raises(SpecError, match=f"{next(iter(rules))} is"):
        on_a_line(**rules)


points = st.lists(st.tuples(st.floats(-0.2, 1.2), st.floats(-2.5, 2.5)), min_size=1, max_size=60)


@settings(max_examples=30, deadline=None)
@given(points, st.integers(1, 5), st.floats(0.001, 0.3), st.floats(0.0, 1.0), st.sampled_from(list(FORMS)))
def test_they_stay_as_many_in_the_unit_cube_and_those_active_are_the_nearest(
    states: list[tuple[float, float]], interval: int, spacing: float, rare: float, form: str
) -> None:
    with FORMS[form]():
        coder = AdaptiveKanerva(
            state=PLANE, prototypes=40, eta=0.1, interval=interval, spacing=spacing, rare=rare, seed=1
        )
    for state in states:
        found = coder.encode(state).indices
        assert coder.prototypes.shape == (40, 2)
        assert coder.prototypes.min() >= 0
        assert coder.prototypes.max() <= 1
        anew = SelectiveKanerva(state=PLANE, prototypes=coder.prototypes, eta=0.1)
        assert found.tolist() == anew.encode(state).indices.tolist()
        assert len(set(found.tolist())) == coder.active == 4
    assert coder.visits.sum() >= 4 * len(states) - 4 * len(states) // interval


@settings(max_examples=30, deadline=None)
@given(points, st.integers(0, 1000))
def test_a_move_changes_no_prediction_for_the_state_it_is_made_for(
    states: list[tuple[float, float]], seed: int
) -> None:
    coder = AdaptiveKanerva(state=PLANE, prototypes=40, eta=0.1, interval=2, spacing=0.01, rare=1.0)
    learner = TD(size=40, active=4, alpha=0.5)
    rng, moved = np.random.default_rng(seed), 0
    last = coder.encode([0.5, 0.0])
    for state in states:
        before = SelectiveKanerva(state=PLANE, prototypes=coder.prototypes, eta=0.1).encode(state)
        predicted = learner.predict(before)
        features = coder.encode(state)
        for move in coder.take_moves():
            learner.inherit(*move)
            moved += 1
        assert learner.predict(features) == pytest.approx(predicted, abs=1e-12)
        learner.update(Transition(last, None, 1.0, rng.normal(), features, None, 0, False, False))
        last = features
    assert moved <= len(states) // 2 + 1


def test_lists_of_neighbours_follow_a_move() -> None:
    coder = AdaptiveKanerva(state=PLANE, prototypes=3000, eta=0.01, interval=7, spacing=0.001, rare=1.0)
    plain_moves = moves = 0
    with kernels.plain():
        plain = AdaptiveKanerva(state=PLANE, prototypes=3000, eta=0.01, interval=7, spacing=0.001, rare=1.0)
    for state in np.cumsum(np.random.default_rng(3).normal(0, 0.01, (300, 2)), axis=0) + np.array((0.5, 0.0)):
        assert coder.encode(state).indices.tolist() == plain.encode(state).indices.tolist()
        moves, plain_moves = moves + len(coder.take_moves()), plain_moves + len(plain.take_moves())
    assert coder.prototypes.tolist() == plain.prototypes.tolist()
    assert moves == plain_moves == 300 // 7


SIZE, ACTIVE = 40, 4
SETTINGS: dict[str, Any] = {"active": ACTIVE, "alpha": 0.3, "gamma": 0.8, "lambda_": 0.7}
CONTROL: dict[str, Any] = SETTINGS | {"actions": 2}
LEARNERS: dict[str, Callable[..., Any]] = {
    "td": partial(TD, **SETTINGS),
    "true online": partial(TrueOnlineTD, **SETTINGS),
    "swift": partial(SwiftTD, **SETTINGS),
    "gtd": partial(GTD, target=(0.5, 0.5), **SETTINGS),
    "sarsa": partial(Sarsa, **CONTROL),
    "q": partial(QLearning, **CONTROL),
    "expected": partial(ExpectedSarsa, policy=Greedy(), **(CONTROL | {"lambda_": 0.0})),
    "true online sarsa": partial(TrueOnlineSarsa, **CONTROL),
}


def vectors(count: int, size: int = SIZE) -> list[FeatureVector]:
    rng = np.random.default_rng(5)
    return [FeatureVector(np.sort(rng.choice(size - 1, ACTIVE, replace=False))) for _ in range(count)]


def steps(coded: list[FeatureVector]) -> Iterator[Transition]:
    rng = np.random.default_rng(6)
    for features, following in pairwise(coded):
        action, then = (int(each) for each in rng.integers(2, size=2))
        yield Transition(features, action, 0.5, rng.normal(), following, then, 0, False, False, (), (rng.normal(),))


def values(learner: Any, features: FeatureVector) -> list[float]:
    told = learner.action_values(features) if hasattr(learner, "action_values") else learner.predict(features)
    return [float(each) for each in np.atleast_1d(told)]


@pytest.mark.parametrize("large", [False, True])
@pytest.mark.parametrize("name", LEARNERS)
def test_a_learner_hands_a_weight_on_and_no_trace_comes_with_it(name: str, large: bool) -> None:
    size = 2000 if large else SIZE  # large enough to be compiled
    learner = LEARNERS[name](size=size)
    coded = vectors(30)
    for step in steps(coded):
        learner.update(step)
    place = int(coded[-2].indices[0])
    like = next(int(each) for each in coded[-5].indices if each != place)
    others = [FeatureVector(np.array([each])) for each in range(SIZE) if each != place]
    untouched = [values(learner, each) for each in others]
    learner.inherit(place, like)
    assert values(learner, FeatureVector(np.array([place]))) == values(learner, FeatureVector(np.array([like])))
    assert [values(learner, each) for each in others] == untouched
    kept = values(learner, FeatureVector(np.array([place])))
    far = FeatureVector(np.array([SIZE - 1]))
    learner.update(Transition(far, 0, 0.5, 5.0, far, 0, 0, False, False))
    assert values(learner, FeatureVector(np.array([place]))) == kept, "it has no trace by which to be moved"


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("algorithm", ["true_online_td", "td"])
def test_demons_hand_on_what_they_predict_wherever_the_feature_is(form: str, algorithm: str) -> None:
    from rtagent.learning import Demons

    signals = {"a": Spec(low=-9.0, high=9.0)}
    sets = (Demons(gammas=(0.5, 0.9), learner=algorithm),)  # type: ignore[arg-type]  # one of its names
    coded = vectors(40)
    for place in (int(coded[-1].indices[1]), int(coded[-2].indices[0]), SIZE - 1):
        with FORMS[form]():
            horde = Horde(size=SIZE, active=ACTIVE, state=signals, demons=sets, precision="float64", lambda_=0.7)
        for step in steps(coded):
            horde.update(step)
        like = next(int(each) for each in coded[-4].indices if each != place)
        others = [FeatureVector(np.array([each])) for each in range(SIZE) if each != place]
        untouched = [horde.predict(each) for each in others]
        horde.inherit(place, like)
        single = [horde.predict(FeatureVector(np.array([each]))) for each in (place, like)]
        assert single[0] == pytest.approx(single[1], abs=1e-12)
        assert np.abs(single[0]).max() > 0
        assert np.array([horde.predict(each) for each in others]) == pytest.approx(np.array(untouched), abs=1e-12)


def test_an_agent_learns_as_one_whose_prototypes_moved_by_hand() -> None:
    rng = np.random.default_rng(8)
    states = [(float(x), float(y)) for x, y in rng.uniform(0.0, 0.5, (80, 2))]

    def coder() -> AdaptiveKanerva:
        return AdaptiveKanerva(state=PLANE, prototypes=50, eta=0.1, interval=4, spacing=0.01, rare=1.0)

    agent = Agent(coder(), TrueOnlineTD(size=50, active=5))
    by_hand, own = TrueOnlineTD(size=50, active=5), coder()
    for number, state in enumerate(states):
        agent.observe(Outcome(state, reward=float(number % 7)), number)
    assert sum(len(transition.moves) for transition in agent.queue) > 10
    from rtagent.backlog import Update

    while agent.queue:
        Update(agent.learner, agent.queue.popleft(), 0, sliced=True).step()
    last = own.encode(states[0])
    for number, state in enumerate(states[1:], start=1):
        features = own.encode(state)
        for move in own.take_moves():
            by_hand.inherit(*move)
        by_hand.update(Transition(last, None, 1.0, float(number % 7), features, None, 0, False, False))
        last = features
    learned: Any = agent.learner
    assert learned.weights.tolist() == by_hand.weights.tolist()


def test_what_cannot_hand_weights_on_is_refused() -> None:
    class Deaf:
        needs_next_action = False

        def predict(self, features: FeatureVector) -> float:
            return 0.0

        def update(self, transition: Transition) -> float:
            return 0.0

    with pytest.raises(SpecError, match="Deaf cannot hand weights on"):
        Agent(on_a_line(), Deaf())
    with pytest.raises(SpecError, match="a Horde learns beside control"):
        PairedCoder(on_a_line(), SelectiveKanerva(state=STATE))
    assert isinstance(Composed(Inputs(STATE), on_a_line()), Moving)
    assert not isinstance(Composed(Inputs(STATE), SelectiveKanerva(state=STATE)), Moving)


def test_it_is_saved_and_goes_on_as_if_nothing_had_been() -> None:
    made = [
        AdaptiveKanerva(state=PLANE, prototypes=60, eta=0.1, interval=3, spacing=0.01, rare=1.0) for _ in range(2)
    ]
    states: FloatArray = np.random.default_rng(2).uniform(0, 1, (90, 2))
    for state in states[:44]:
        made[0].encode(state)
    made[1].restore(made[0].save())
    for state in states[44:]:
        assert made[0].encode(state).indices.tolist() == made[1].encode(state).indices.tolist()
    assert made[0].prototypes.tolist() == made[1].prototypes.tolist()
    assert made[0].take_moves() == made[1].take_moves() != ()
    with pytest.raises(SpecError, match="saved with other settings"):
        on_a_line().restore(made[0].save())


def test_a_scenario_can_have_it(tmp_path: Any) -> None:
    changed = ["features.type=adaptive_kanerva", "features.interval=5", "features.prototypes=300"]
    faked = ["run.fake=process", "run.clock=virtual", "run.episode_time=1s"]
    result = clock.run(assemble(load(SCENARIOS / "grasping.toml", [*changed, *faked])).run(), "virtual")
    coder: Any = result.agents[0].features
    began = SelectiveKanerva(state=coder.inputs.specs, prototypes=300, eta=0.025).prototypes
    assert 0 < np.any(coder.coder.prototypes != began, axis=1).sum() < 300
