"""A Horde beside control: both learn exactly what they learn apart, whole or in slices, saved and restored."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import Spec, kernels
from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.features import Composed, Inputs, OneHot, PairedCoder, PairedVector, SelectiveKanerva, Tabular, Traced
from rtagent.learning import TD, Demons, Horde, QLearning, Sarsa, TrueOnlineSarsa, WithHorde
from rtagent.policy import EpsilonGreedy

STATE = {"emergency": Spec.flag(), "position": Spec(low=-1.0, high=1.0), "load": Spec(low=0.0, high=1.0)}
DEMONS = (
    Demons(signals=("position", "load"), gammas=(0.5, 0.9), bins=3),
    Demons(signals=("load",), gammas=(0.3,), learner="gtd", policy=(0.25, 0.75), name="mostly stop"),
)


def control_coder() -> Composed:
    inputs = Inputs(STATE, signals=["emergency"])
    return Composed(inputs, Tabular(state=inputs.specs))


def horde_coder() -> Composed:
    inputs = Inputs(STATE, signals=["position", "load"], traces=[Traced(0.5, ("load",))])
    return Composed(inputs, SelectiveKanerva(state=inputs.specs, prototypes=40, eta=0.1), bias=True)


def paired() -> PairedCoder:
    return PairedCoder(control_coder(), horde_coder())


def signals(step: int) -> FloatArray:
    return np.array([float(step % 7 > 4), np.sin(0.3 * step), 0.5 + 0.5 * np.cos(0.2 * step)])


def stream(count: int, *, length: int = 25) -> list[Transition]:
    """Return the transitions of episodes, every third of which terminates, under a random policy."""
    rng, coder, made = np.random.default_rng(0), paired(), []
    policy = EpsilonGreedy(epsilon=0.4)
    here, action = coder.encode(signals(0)), 0
    for step in range(count):
        ends = step % length == length - 1
        if step % length == 0:
            coder.begin()
            here = coder.encode(signals(step))
        there = coder.encode(signals(step + 1))
        next_action, probability = policy.choose(rng.random(2), rng)
        terminated, truncated = ends and step % 3 == 0, ends and step % 3 > 0
        made.append(
            Transition(
                here, action, probability, float(rng.normal()), there, next_action, 10_000_000,
                terminated, truncated, signals(step), signals(step + 1),
            )
        )  # fmt: skip
        here, action = there, next_action
    return made


STREAM = stream(120)
CONTROL: dict[str, Any] = {"sarsa": Sarsa, "q_learning": QLearning, "true_online_sarsa": TrueOnlineSarsa}


def make_control(name: str = "sarsa") -> Any:
    coder = control_coder()
    return CONTROL[name](size=coder.size, active=coder.active, actions=2, alpha=0.2)


def make_horde() -> Horde:
    coder = horde_coder()
    return Horde(size=coder.size, active=coder.active, actions=2, state=STATE, demons=DEMONS, measured=3)


def apart(name: str, transitions: Sequence[Transition]) -> tuple[Any, Horde, list[float]]:
    """Learn with each alone: control from what a coder of its own gave, and the Horde likewise."""
    control, horde = make_control(name), make_horde()
    deltas = [control.update(replace(t, **plain(t))) for t in transitions]
    for t in transitions:
        horde.update(replace(t, features=t.features.horde, next_features=t.next_features.horde))  # type: ignore[attr-defined]
    return control, horde, deltas


def plain(t: Transition) -> dict[str, FeatureVector]:
    return {"features": FeatureVector(*t.features), "next_features": FeatureVector(*t.next_features)}


def state_of(learner: Any) -> list[Any]:
    """Return all that is saved, in one order, with arrays as bytes."""

    def flat(saved: Any) -> Any:
        if isinstance(saved, dict):
            return {name: flat(saved[name]) for name in sorted(saved)}
        return saved.tobytes() if isinstance(saved, np.ndarray) else repr(saved)

    return [flat(learner.save())]


def interrupted(work: Generator[None, None, float], looks: int, learner: WithHorde) -> float:
    """Do the work, looking at what it has predicted by then at each of `looks` first slices."""
    place = 0
    while True:
        try:
            next(work)
        except StopIteration as done:
            return float(done.value)
        if place < looks:
            learner.action_values(STREAM[0].features)
            learner.horde.predict(STREAM[0].features.horde)  # type: ignore[attr-defined]
            learner.horde.newest  # noqa: B018  # looking must change nothing
        place += 1


@pytest.mark.parametrize("name", CONTROL)
@pytest.mark.parametrize("sliced", [False, True])
def test_both_learn_to_the_bit_what_they_learn_apart(name: str, sliced: bool) -> None:
    control, horde, deltas = apart(name, STREAM)
    both = WithHorde(make_control(name), make_horde())
    learn = (lambda t: interrupted(both.updating(t), 0, both)) if sliced else both.update
    assert [learn(t) for t in STREAM] == deltas
    assert state_of(both.control) == state_of(control)
    assert state_of(both.horde) == state_of(horde)
    assert both.errors() == horde.errors()
    assert any(errors.verified for errors in both.errors().values())
    assert np.any(both.horde.newest)
    assert both.needs_next_action == control.needs_next_action


@pytest.mark.parametrize("name", CONTROL)
def test_compiled_control_takes_paired_features_as_its_own(name: str) -> None:
    """With so many weights control learns by kernels, which see a state with real-valued features."""
    coder = SelectiveKanerva(state=STATE, prototypes=800, eta=0.02, proximity=True)
    pairs = PairedCoder(coder, horde_coder())
    settings = {"size": coder.size, "active": coder.active, "actions": 2}
    both, alone = WithHorde(CONTROL[name](**settings), make_horde()), CONTROL[name](**settings)
    seen = [pairs.encode(signals(step)) for step in range(len(STREAM) + 1)]
    for t, here, there in zip(STREAM, seen, seen[1:], strict=False):
        t = replace(t, features=here, next_features=there)
        assert interrupted(both.updating(t), 1, both) == alone.update(replace(t, **plain(t)))
        assert np.array_equal(both.action_values(there), alone.action_values(FeatureVector(*there)))
    assert both.control.weights.any()  # type: ignore[attr-defined]


@settings(max_examples=20)
@given(st.lists(st.integers(0, 12), min_size=len(STREAM), max_size=len(STREAM)))
@pytest.mark.slow
def test_where_an_update_is_interrupted_changes_nothing(looks: list[int]) -> None:
    whole, sliced = (WithHorde(make_control(), make_horde()) for _ in range(2))
    for t, count in zip(STREAM, looks, strict=True):
        assert interrupted(sliced.updating(t), count, sliced) == whole.update(t)
    assert state_of(sliced) == state_of(whole)


def test_control_has_learned_before_the_first_pause() -> None:
    both, control = WithHorde(make_control(), make_horde()), make_control()
    for t in STREAM[:20]:
        work = both.updating(t)
        next(work)
        control.update(t)
        assert np.array_equal(both.action_values(t.features), control.action_values(t.features))
        for _ in work:
            pass


def test_one_prediction_is_that_of_all_to_the_bit_at_any_slice() -> None:
    both = WithHorde(make_control(), make_horde())
    there: Any = STREAM[7].features
    for t in STREAM[:60]:
        for _ in both.updating(t):
            one_by_one = [both.prediction(name, there) for name in both.names]
            assert one_by_one == both.horde.predict(there.horde).tolist()
    with pytest.raises(SpecError, match=r"no demon 'lod γ=0\.5': did you mean 'load γ=0\.5'"):
        both.prediction("lod γ=0.5", there)


@pytest.mark.parametrize("compiled", [True, False])
def test_one_of_many_predictions_is_found_in_the_middle_of_a_fold(compiled: bool) -> None:
    """Slices so short that folds, and steps, are left at every row and demon."""
    coder = horde_coder()
    demons = (Demons(signals=("load",), gammas=(0.5,), bins=70, lambda_=0.5),)
    with contextlib.nullcontext() if compiled else kernels.plain():
        horde = Horde(size=coder.size, active=coder.active, state=STATE, demons=demons, measured=0)
    if compiled:
        horde.groups[0].learned.slice_bytes = 1  # type: ignore[attr-defined]  # of the compiled form
    slices = 0
    for t in STREAM[:80]:
        features: Any = t.features
        for _ in horde.updating(replace(t, features=features.horde, next_features=t.next_features.horde)):  # type: ignore[attr-defined]
            all_of_them = horde.predict(features.horde).tolist()
            assert [horde.prediction(horde.names[place], features.horde) for place in (0, 31, 32, 70)] == [
                all_of_them[place] for place in (0, 31, 32, 70)
            ]
            slices += 1
    assert slices > (500 if compiled else 79)


class Unsliced:
    """A control learner of the user's own, with no slices and nothing to save."""

    needs_next_action = False

    def __init__(self) -> None:
        self.learned: list[Transition] = []

    def action_values(self, features: FeatureVector) -> FloatArray:
        return np.zeros(2)

    def update(self, transition: Transition) -> float:
        self.learned.append(transition)
        return 0.5


def test_a_control_learner_without_slices_will_do() -> None:
    both = WithHorde(Unsliced(), make_horde())
    assert interrupted(both.updating(STREAM[0]), 0, both) == 0.5
    assert both.control.learned == [STREAM[0]]  # type: ignore[attr-defined]
    assert list(both.save()) == ["horde"]


def test_a_restored_learner_and_coder_go_on_as_if_nothing_had_been() -> None:
    first, second = (WithHorde(make_control(), make_horde()) for _ in range(2))
    one, other = paired(), paired()
    for t in STREAM[:60]:
        first.update(t)
    for step in range(10):
        one.encode(signals(step))
    second.restore(first.save())
    other.restore(one.save())
    for t in STREAM[60:]:
        assert first.update(t) == second.update(t)
    assert state_of(first) == state_of(second)
    again, anew = one.encode(signals(10)), other.encode(signals(10))
    assert np.array_equal(again.horde.values, anew.horde.values)  # type: ignore[arg-type]  # traces have values


def test_what_was_saved_by_another_is_refused_and_changes_nothing() -> None:
    both = WithHorde(make_control(), make_horde())
    for t in STREAM[:30]:
        both.update(t)
    before = state_of(both)
    larger = Sarsa(size=5, actions=2).save()
    with pytest.raises(SpecError, match="shape"):
        both.restore({**both.save(), "control": larger})
    with pytest.raises(SpecError, match="has no 'control'"):
        both.restore({"horde": make_horde().save()})
    assert state_of(both) == before


def test_a_state_is_coded_for_each_as_by_its_own_coder() -> None:
    coder, control, horde = paired(), control_coder(), horde_coder()
    assert (coder.size, coder.active) == (control.size, control.active)
    for step in range(20):
        if step == 12:
            for each in (coder, control, horde):
                each.begin()
        features, own, beside = (each.encode(signals(step)) for each in (coder, control, horde))
        assert isinstance(features, PairedVector)
        assert np.array_equal(features.indices, own.indices)
        assert features.values is own.values is None
        assert np.array_equal(features.horde.indices, beside.indices)


def test_what_lies_outside_is_counted_once_for_both() -> None:
    clips = SelectiveKanerva(state=STATE, prototypes=20, eta=0.2)
    masks = Composed(Inputs(STATE, outside="mask"), SelectiveKanerva(state=STATE, prototypes=20, eta=0.2))
    coder = PairedCoder(Composed(Inputs(STATE, signals=["position"]), OneHotOfSign()), clips)
    coder.encode([0.0, 5.0, -3.0])
    assert coder.clipped == {"emergency": 0, "position": 1, "load": 1}
    assert coder.masked["position"] == 0
    beside = PairedCoder(control_coder(), masks)
    beside.encode([0.0, 5.0, 0.5])
    assert (beside.masked["position"], beside.masked["load"]) == (1, 0)
    assert PairedCoder(OneHot(state={"a": Spec.flag()}), OneHot(state={"a": Spec.flag()})).clipped == {}


class OneHotOfSign:
    """One of two features, by the sign of the one signal."""

    size, active = 2, 1

    def encode(self, state: Any) -> FeatureVector:
        return FeatureVector(np.array([int(state[0] > 0)]))


def test_what_cannot_work_is_refused() -> None:
    with pytest.raises(SpecError, match="TD values no actions: take one for control, such as sarsa"):
        WithHorde(TD(size=2), make_horde())  # type: ignore[arg-type]  # that is the mistake
    both = WithHorde(make_control(), make_horde())
    with pytest.raises(SpecError, match="give the agent a PairedCoder"):
        both.update(replace(STREAM[0], **plain(STREAM[0])))


def test_what_control_refuses_reaches_no_demon() -> None:
    both = WithHorde(make_control(), make_horde())
    before = state_of(both)
    for learn in (both.update, lambda t: interrupted(both.updating(t), 0, both)):
        with pytest.raises(SpecError, match="reward is nan"):
            learn(replace(STREAM[0], reward=np.nan))
    assert state_of(both) == before


@pytest.mark.parametrize(
    ("actions", "policy", "sentence"),
    [
        (2, (1.0,), "give the probability of each of the 2 actions"),
        (2, (0.5, 0.4), "together 1"),
        (0, (0.5, 0.5), "this run only predicts"),
    ],
)
def test_a_policy_to_ask_about_is_checked(actions: int, policy: tuple[float, ...], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        Horde(size=4, actions=actions, state=STATE, demons=(Demons(learner="gtd", policy=policy),))


def test_a_policy_needs_a_learner_that_can_ask_about_it() -> None:
    with pytest.raises(SpecError, match="gtd, and nothing else"):
        Horde(size=4, actions=2, state=STATE, demons=(Demons(policy=(0.5, 0.5)),))
    with pytest.raises(SpecError, match="gtd, and nothing else"):
        Horde(size=4, actions=2, state=STATE, demons=(Demons(learner="gtd"),))
