"""Hordes: what is declared is predicted, in groups that share; returns, errors, layers, and bad input."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from rtagent import Spec, kernels
from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.features import SelectiveKanerva
from rtagent.learning import Continuation, Demon, Demons, Horde, Method, SwiftTD, TrueOnlineTD
from rtagent.learning.cumulants import Signal
from rtagent.learning.returns import Rupee, Verifier

STATE = {
    "shoulder_position": Spec(low=-1.0, high=3.0),
    "shoulder_load": Spec(low=0.0, high=1.0),
    "elbow_position": Spec(low=-2.0, high=2.0),
}
CODER = SelectiveKanerva(state=STATE, prototypes=60, eta=0.1)


def signals(step: int) -> FloatArray:
    phase = 0.1 * step
    return np.array([1.0 + 2.0 * np.sin(phase), 0.5 + 0.5 * np.cos(phase), 2.0 * np.sin(2 * phase)])


def transitions(count: int, *, length: int = 0, begin: int = 0) -> Iterator[Transition]:
    """Yield steps of 100 ms each; with `length` in episodes that terminate."""
    for step in range(begin, begin + count):
        ended = bool(length) and step % length == length - 1
        here, there = signals(step), signals(step + 1)
        yield Transition(
            CODER.encode(here), None, 1.0, 0.0, CODER.encode(there), None, 100_000_000, ended, False, here, there
        )


def horde(*demons: Demons | Demon, **settings: object) -> Horde:
    made = {"precision": "float64"} | settings
    return Horde(size=CODER.size, active=CODER.active, state=STATE, demons=demons, **made)  # type: ignore[arg-type]


def learned(made: Horde, count: int = 60, **stream: int) -> Horde:
    for transition in transitions(count, **stream):
        made.update(transition)
    return made


def test_one_declaration_makes_a_demon_for_each_signal_and_time_scale() -> None:
    made = horde(Demons(signals=("*_position",), gammas=(0.5, 0.9)))
    assert made.names == [
        "shoulder_position γ=0.5", "elbow_position γ=0.5", "shoulder_position γ=0.9", "elbow_position γ=0.9",
    ]  # fmt: skip
    assert [len(group.learned.estimate) for group in made.groups] == [2, 2], "those of one time scale share a trace"


def test_2576_demons_from_one_declaration() -> None:
    joints = {f"joint_{number}_{kind}": Spec(low=0.0, high=1.0) for number in range(7) for kind in "pvtl"}
    made = Horde(size=50, active=5, state=joints, demons=(Demons(gammas=(0.5, 0.9, 0.97, 0.99), bins=22),))
    assert len(made) == 2576
    assert len(made.groups) == 4


def test_bins_share_the_time_between_them() -> None:
    made = learned(horde(Demons(signals=("shoulder_load",), bins=4)), 3000)
    value, *parts = made.newest.tolist()
    assert sum(parts) == pytest.approx(1.0, abs=0.02)
    assert value == pytest.approx(signals(3000)[1], abs=0.3)


@pytest.mark.parametrize("compiled", [True, False])
def test_each_demon_learns_what_a_learner_of_its_own_does(compiled: bool) -> None:
    declared = (
        Demons(gammas=(0.5, 0.9), lambda_=0.8),
        Demons(signals=("shoulder_load",), gammas=(0.7,), lambda_=0.0),
    )
    if compiled:
        made = horde(*declared)
    else:
        with kernels.plain():
            made = horde(*declared)
    alone = [
        TrueOnlineTD(
            size=CODER.size, active=CODER.active, alpha=0.1,
            gamma=demon.continuation.gamma, lambda_=demon.method.lambda_,
        )
        for demon in made.demons
    ]  # fmt: skip
    for t in transitions(300, length=90):
        made.update(t)
        for demon, learner in zip(made.demons, alone, strict=True):
            assert isinstance(demon.cumulant, Signal)
            reward = (1.0 - float(demon.continuation.gamma)) * float(t.next_state[demon.cumulant.place])  # type: ignore[arg-type]
            learner.update(
                Transition(t.features, None, 1.0, reward, t.next_features, None, 0, t.terminated, t.truncated)
            )
    there = CODER.encode(signals(7))
    np.testing.assert_allclose(made.predict(there), [learner.predict(there) for learner in alone], atol=1e-10)


def test_gamma_each_second_is_that_power_of_the_time_that_passed() -> None:
    by_second = learned(horde(Demons(gammas=(0.9**10,), gamma_per="second")))
    by_step = learned(horde(Demons(gammas=(0.9,))))
    np.testing.assert_allclose(by_second.newest, by_step.newest, atol=1e-12)


def test_a_demon_of_ones_own_has_any_cumulant_and_continuation() -> None:
    def until_high(t: Transition) -> float:
        return 0.0 if t.next_state[0] > 2.5 else 1.0

    steps = Demon("steps until high", lambda t: 1.0, Continuation(until_high), normalised=False)
    made = learned(horde(steps, measured=1), 4000)
    (errors,) = made.errors().values()
    assert errors.verified > 3800
    assert errors.mae < 8, "it counts some 60 steps down"
    assert 10 < made.newest[0] < 80


@pytest.mark.parametrize("compiled", [True, False])
def test_one_prediction_is_that_among_all(compiled: bool) -> None:
    with contextlib.nullcontext() if compiled else kernels.plain():
        made = horde(Demons(gammas=(0.5, 0.9)), Demons(signals=("shoulder_load",), learner="td", name="td"))
    learned(made, 30)
    there = CODER.encode(signals(7))
    updating = made.updating(next(transitions(1, begin=30)))
    for _ in updating:  # also in the middle of an update
        alone = [made.prediction(name, there) for name in made.names]
        assert alone == made.predict(there).tolist()
    with pytest.raises(SpecError, match=r"did you mean .shoulder_load"):
        made.prediction("shoulder_lod γ=0.5", there)


def test_a_demon_may_adapt_its_step_sizes() -> None:
    made = horde(Demons(signals=("shoulder_load",), learner="swift_td", alpha=0.01, divide_alpha=False))
    alone = SwiftTD(size=CODER.size, active=CODER.active, alpha=0.01, divide_alpha=False)
    for t in transitions(200, length=70):
        made.update(t)
        reward = (1.0 - 0.9) * float(t.next_state[1])
        alone.update(Transition(t.features, None, 1.0, reward, t.next_features, None, 0, t.terminated, t.truncated))
    assert made.newest[0] == pytest.approx(alone.predict(CODER.encode(signals(200))))


def test_a_demon_asks_about_a_policy_that_is_not_the_agents() -> None:
    """The agent takes both actions alike; the demon asks about the first, after which the cumulant is 1."""
    rng = np.random.default_rng(0)
    always_first = Demon("first", lambda t: float(t.action == 0), Continuation(0.5), (1.0, 0.0), Method("gtd"))
    as_it_is = Demon("both", lambda t: float(t.action == 0), Continuation(0.5))
    made = horde(always_first, as_it_is)
    for t in transitions(3000):
        t.action, t.probability = int(rng.integers(2)), 0.5
        made.update(t)
    assert made.newest.tolist() == pytest.approx([1.0, 0.5], abs=0.15)


def test_predictions_are_features_of_others() -> None:
    """By hand: the features of the upper demon are those of the agent and both predictions below, as fractions."""
    below = Demons(signals=("*_position",), gammas=(0.5,), name="below")
    above = Demons(
        signals=("shoulder_load",), gammas=(0.8,), alpha=0.01, divide_alpha=False, name="above", on=("below",)
    )
    made = horde(above, below)
    assert made.names[0] == "above: shoulder_load γ=0.8", "the order is that of the declaration"
    alone = TrueOnlineTD(size=CODER.size + 2, alpha=0.01, gamma=0.8, lambda_=0.9)
    lows, highs = np.array([-1.0, -2.0]), np.array([3.0, 2.0])

    def joined(features: FeatureVector, predictions: FloatArray) -> FeatureVector:
        fractions = np.clip((predictions - lows) / (highs - lows), 0, 1)
        indices = np.concatenate((features.indices, [CODER.size, CODER.size + 1]))
        return FeatureVector(indices, np.concatenate((np.ones(CODER.active), fractions)))

    first = next(transitions(1))
    here = joined(first.features, made.predict(first.features)[1:])
    for t in transitions(150):
        made.update(t)
        there = joined(t.next_features, made.newest[1:])
        alone.update(Transition(here, None, 1.0, 0.2 * float(t.next_state[1]), there, None, 0, False, False))
        here = there
    weights = made.groups[1].learned.weights[:, 0]
    np.testing.assert_allclose(weights, alone.weights, atol=1e-9)


def test_errors_are_those_against_the_true_returns() -> None:
    made = horde(Demons(signals=("*_position",), gammas=(0.8,)), measured=2)
    steps = list(transitions(400, length=130))
    predicted = []
    for t in steps:
        made.update(t)
        predicted.append(made.newest)
    expected: list[FloatArray] = []
    for number in range(1, len(steps)):
        if number % 130 == 0:
            continue  # the first prediction of an episode is made before anything of it is learned
        total, weight = np.zeros(2), 0.2
        for later in steps[number:]:
            total += weight * np.asarray(later.next_state)[[0, 2]]
            weight *= 0.8
            if later.terminated:
                break
        expected.append(predicted[number - 1] - total)
    for place, errors in enumerate(made.errors().values()):
        assert 330 < errors.verified < len(expected)
        apart = np.abs(np.array(expected)[: errors.verified, place])
        assert errors.mae == pytest.approx(apart.mean(), rel=5e-3)
        assert errors.rmse == pytest.approx(np.sqrt(np.mean(apart**2)), rel=5e-3)


def drain(work: Iterator[None]) -> None:
    for _ in work:
        pass


def test_what_never_has_a_known_return_is_counted() -> None:
    verifier = Verifier(1)
    for number in range(10):
        drain(verifier.add(np.zeros(1), np.ones(1), 0.9, number == 9))  # truncated: γ is not 0
    (errors,) = verifier.errors()
    assert (errors.verified, errors.unverified) == (0, 10)
    drain(verifier.add(np.zeros(1), np.ones(1), 0.0, True))
    (errors,) = verifier.errors()
    assert (errors.verified, errors.mae) == (1, 1.0)


def test_rupee_is_what_its_definition_gives() -> None:
    """Against the dense definition, with the average begun at 0 and corrected for it."""
    rng = np.random.default_rng(0)
    size, alpha, beta = 12, 0.05, 0.01
    made = Rupee(size, 2, alpha, beta)
    h, average, trace = np.zeros((size, 2)), np.zeros((size, 2)), np.zeros(size)
    for step in range(300):
        indices = rng.permutation(size)[:3]
        x = np.zeros(size)
        x[indices] = 1.0
        delta, decay = rng.normal(size=2), float(rng.choice([0.8, 0.8, 0.0]))
        made.add(indices, np.ones(3), delta, decay)
        trace = trace + x
        credit = np.outer(trace, delta)
        h = h + alpha * (credit - np.outer(x, h.T @ x))
        rate = beta / (1 - (1 - beta) ** (step + 1))
        average = (1 - rate) * average + rate * credit
        trace = trace * decay
    np.testing.assert_allclose(made.values(), np.sqrt(np.abs((h * average).sum(axis=0))), rtol=1e-6)


def test_a_restored_horde_goes_on_as_if_nothing_had_been() -> None:
    declared = (
        Demons(signals=("*_position",), gammas=(0.5,), name="below"),
        Demons(signals=("shoulder_load",), on=("below",), name="above"),
        Demons(signals=("shoulder_load",), learner="swift_td", name="swift"),
    )
    first, second = (horde(*declared, rupee=True) for _ in range(2))
    learned(first, 70, length=50)
    second.restore(first.save())
    for made in (first, second):
        learned(made, 70, length=50, begin=70)
    assert np.array_equal(first.newest, second.newest)
    assert first.errors() == second.errors()


def test_a_signal_outside_its_range_is_learned_from_as_its_end_and_counted() -> None:
    made = horde(Demons(signals=("shoulder_load",), gammas=(0.0,), alpha=1.0))
    (t,) = transitions(1)
    t.next_state = np.array([0.0, -16245.0, 0.0])
    made.update(t)
    assert made.clipped == {"shoulder_position": 0, "shoulder_load": 1, "elbow_position": 0}
    assert made.predict(t.features)[0] == 0.0


@pytest.mark.parametrize("compiled", [True, False])
def test_what_is_not_a_number_reaches_no_weight(compiled: bool) -> None:
    (t,) = transitions(1)
    made = horde(Demons(), Demon("mine", lambda t: float("inf")))
    with pytest.raises(SpecError, match="demon 'mine' is inf"):
        made.update(t)
    t.next_state = np.array([0.0, np.nan, 0.0])
    with pytest.raises(SpecError, match="'shoulder_load' is not a number"):
        made.update(t)
    assert not made.newest.any()
    assert not any(group.learned.weights.any() for group in made.groups)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("index", [-1, 60, 10**9])
def test_a_feature_that_there_is_no_weight_for_is_told(compiled: bool, index: int) -> None:
    (good,) = transitions(1)
    wrong = FeatureVector(np.array([index]))
    with contextlib.nullcontext() if compiled else kernels.plain():
        made = horde(Demons())
    for bad in (replace(good, features=wrong), replace(good, next_features=wrong)):
        with pytest.raises(SpecError, match=f"there is no feature {index}"):
            made.update(bad)
    assert not any(group.learned.weights.any() for group in made.groups)


@pytest.mark.parametrize(
    ("demons", "sentence"),
    [
        ((), "demons is empty"),
        ((Demons(signals=("hip*",)),), r"no signal fits 'hip\*': the state has shoulder_position"),
        ((Demons(gammas=(1.5,)),), "gamma is 1.5"),
        ((Demons(gammas=()),), "gammas is empty"),
        ((Demons(alpha=0.0),), "alpha is 0"),
        ((Demons(lambda_=2.0),), "lambda_ is 2"),
        ((Demons(), Demons()), "two demons are called 'shoulder_position γ=0.9': give one of their sets a name"),
        ((Demons(on=("nothing",)),), "on names 'nothing', and no set of demons is called that"),
        ((Demons(name="a", on=("b",)), Demons(name="b", on=("a",))), "the demons 'a' are built on themselves"),
        ((Demons(name="a", normalised=False), Demons(on=("a",))), "let them be normalised"),
    ],
)
def test_what_cannot_work_is_refused(demons: tuple[Demons, ...], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        horde(*demons)


def test_only_gtd_learns_about_another_policy() -> None:
    with pytest.raises(SpecError, match="has the policy None and learns by gtd"):
        Demon("mine", Signal(0), method=Method("gtd"))
    with pytest.raises(SpecError, match=r"has the policy \(0.5, 0.5\) and learns by true_online_td"):
        Demon("mine", Signal(0), policy=(0.5, 0.5))


def test_bins_need_a_range() -> None:
    with pytest.raises(SpecError, match="'speed' cannot be cut into 4 bins"):
        Horde(size=4, state={"speed": Spec()}, demons=(Demons(bins=4),))


def test_more_than_the_machine_has_is_refused_before_it_is_taken() -> None:
    with pytest.raises(SpecError, match=r"12 TB for the weights of 3 demons over 1,000,000,000,000 features"):
        Horde(size=10**12, active=1, state=STATE, demons=(Demons(),))


def test_the_root_mean_square_of_the_deltas_is_returned() -> None:
    made = horde(Demons(gammas=(0.0,)), Demon("one", lambda t: 1.0, Continuation(0.0), method=Method(alpha=0.5)))
    (t,) = transitions(1)
    values = [*t.next_state, 1.0]
    assert made.update(t) == pytest.approx(np.sqrt(np.mean(np.square(values))))
