"""Streams that are coded and learned at once: the same as row by row, to the last bit."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext

import numpy as np
import pytest

from rtagent import kernels
from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.experiments import chunks
from rtagent.experiments.chunks import follow_chunks
from rtagent.features import AdaptiveKanerva, SelectiveKanerva
from rtagent.learning import SwiftTD, TrueOnlineTD
from rtagent.specs import Spec

STATE = {"x": Spec(low=0.0, high=2.0), "y": Spec(low=-1.0, high=1.0)}
Learner = TrueOnlineTD | SwiftTD
Make = Callable[[SelectiveKanerva], Learner]

LEARNERS: dict[str, Make] = {
    "true online": lambda coder: TrueOnlineTD(size=coder.size, active=coder.active, gamma=0.9, lambda_=0.8),
    "swift": lambda coder: SwiftTD(size=coder.size, active=coder.active, gamma=0.9, lambda_=0.8, eta=0.5),
}
FORMS = {"compiled": nullcontext, "plain": kernels.plain}


def walk(rows: int, seed: int = 0) -> FloatArray:
    """Return states that wander about, now and then beyond their ranges."""
    steps = np.random.default_rng(seed).normal(0.0, 0.1, (rows, 2))
    return np.abs((np.cumsum(steps, axis=0) + 1.0) % 4.4 - 2.2) - (0.0, 1.0)


def coder(**settings: object) -> SelectiveKanerva:
    return SelectiveKanerva(state=STATE, prototypes=600, eta=0.02, **settings)  # type: ignore[arg-type]  # its own


def learn_one_by_one(learner: Learner, coded: list[FeatureVector], rewards: FloatArray) -> list[float]:
    """Learn with a transition for each step; return what was predicted before each."""
    predictions = []
    for features, following, reward in zip(coded, coded[1:], rewards, strict=False):
        predictions.append(learner.predict(features))
        learner.update(Transition(features, None, 1.0, float(reward), following, None, 0, False, False))
    return predictions


@pytest.mark.parametrize("proximity", [False, True])
@pytest.mark.parametrize("form", FORMS)
def test_states_are_coded_at_once_as_one_by_one(form: str, proximity: bool) -> None:
    states = walk(150)
    with FORMS[form]():
        at_once, one_by_one = coder(proximity=proximity), coder(proximity=proximity)
        indices, values = at_once.encode_each(states)
    for row, state in enumerate(states):
        expected = one_by_one.encode(state)
        assert indices[row].tolist() == expected.indices.tolist()
        if expected.values is None:
            assert values is None
        else:
            assert values is not None
            assert values[row].tolist() == expected.values.tolist()
    assert at_once.clipped == one_by_one.clipped
    assert sum(at_once.clipped.values()) > 0


@pytest.mark.parametrize("form", FORMS)
def test_a_state_that_is_wrong_is_refused_by_the_name_of_its_signal(form: str) -> None:
    states = walk(5)
    states[3, 1] = np.nan
    with FORMS[form]():
        made = coder()
    with pytest.raises(SpecError, match="'y' is not a number"):
        made.encode_each(states)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", LEARNERS)
def test_a_stream_is_learned_at_once_as_one_by_one_to_the_last_bit(name: str, form: str) -> None:
    made = coder()
    indices, _ = made.encode_each(walk(400))
    coded, rewards = [FeatureVector(row) for row in indices], np.random.default_rng(1).normal(size=399)
    with FORMS[form]():
        at_once, one_by_one = LEARNERS[name](made), LEARNERS[name](made)
    predictions = np.concatenate(
        [at_once.follow(indices[:201], rewards[:200]), at_once.follow(indices[200:], rewards[200:])]
    )
    assert predictions.tolist() == learn_one_by_one(one_by_one, coded, rewards)
    assert at_once.weights.tolist() == one_by_one.weights.tolist()
    assert np.abs(at_once.weights).max() > 0
    told = at_once.predict_each(indices)
    assert told.tolist() == pytest.approx([one_by_one.predict(each) for each in coded], abs=1e-12)


def test_a_chunk_is_learned_up_to_a_row_and_only_predicted_from_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "CHUNK", 64)
    states, until = walk(300), 150
    cumulants = {"a": states[:, 0], "b": states[:, 1] ** 2}
    learners = {name: LEARNERS["true online"](coder()) for name in cumulants}
    found = follow_chunks(states, coder(), learners, cumulants, until)
    coded = [coder_.encode(state) for coder_ in [coder()] for state in states]
    for name, values in cumulants.items():
        expected = LEARNERS["true online"](coder())
        before = learn_one_by_one(expected, coded[: until + 1], values)
        after = [expected.predict(features) for features in coded[until:]]
        assert found[name].tolist() == before + after


def test_prototypes_move_between_chunks_and_their_weights_are_handed_on() -> None:
    states, made = walk(200), {"prototypes": 100, "eta": 0.05, "interval": 20, "spacing": 0.001, "rare": 1.0}
    at_once, own = (AdaptiveKanerva(state=STATE, **made) for _ in range(2))  # type: ignore[arg-type]  # its own
    learners = [TrueOnlineTD(size=100, active=5, gamma=0.9, lambda_=0.8) for _ in range(2)]
    found = follow_chunks(states, at_once, {"it": learners[0]}, {"it": states[:, 0]}, 100)["it"]
    expected, moves = [], 0
    for first in range(0, 100, 20):
        indices, _ = own.encode_each(states[first : first + 21])
        coded = [FeatureVector(row) for row in indices]
        expected += learn_one_by_one(learners[1], coded, states[first : first + 20, 0])
        for move in own.adapt(states[first + 20]):
            learners[1].inherit(*move)
            moves += 1
    assert moves == 5
    assert found[:100].tolist() == expected
    assert at_once.prototypes.tolist() == own.prototypes.tolist()


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("alpha", [0.05, 4.0])
def test_a_learner_that_diverges_predicts_nothing_from_there_on(form: str, alpha: float) -> None:
    made, states = coder(), walk(600)
    with FORMS[form]():
        common = {"size": made.size, "active": made.active, "gamma": 0.99}
        learner = TrueOnlineTD(alpha=alpha, lambda_=0.9, **common)  # type: ignore[arg-type]  # numbers
    found = follow_chunks(states, made, {"it": learner}, {"it": 1e3 * states[:, 0]}, 500)["it"]
    assert np.isnan(found).any() == (alpha > 1)
    assert np.isfinite(learner.weights).all()


def test_what_depends_on_the_transition_is_not_followed() -> None:
    learner = TrueOnlineTD(size=10, gamma=lambda transition: 0.5)
    with pytest.raises(SpecError, match="one by one"):
        learner.follow(np.zeros((3, 1), np.intp), np.zeros(2))
