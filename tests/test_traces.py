"""Both forms of weights and trace do the same, whatever happens to them; what is saved goes on exactly."""

from __future__ import annotations

import itertools
import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import Generator
from parts import ROOT

from rtagent import kernels
from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, Transition
from rtagent.kernels import linear
from rtagent.learning import TD, ExpectedSarsa, QLearning, Sarsa, SwiftTD, TrueOnlineSarsa, TrueOnlineTD
from rtagent.learning.lazy import LazyTraces
from rtagent.learning.swift import SparseSwift
from rtagent.learning.traces import DenseTraces, Traces, make_traces
from rtagent.policy import EpsilonGreedy
from rtagent.saving import Saved

pytestmark = pytest.mark.slow

SIZE, ACTIVE = 1200, 24
Make = Callable[..., Any]

GAMMAS, LAMBDAS = (0.0, 0.5, 0.9, 0.99, 1.0), (0.0, 0.3, 0.9, 1.0)
BY_STATE = {
    "gamma": lambda t: GAMMAS[int(t.next_features.indices[0]) % len(GAMMAS)],
    "lambda_": lambda t: LAMBDAS[int(t.next_features.indices[-1]) % len(LAMBDAS)],
}


def td(**settings: Any) -> TD:
    return TD(**{"alpha": 0.1} | settings)


def true_online_td(**settings: Any) -> TrueOnlineTD:
    return TrueOnlineTD(**{"alpha": 0.1} | settings)


def replacing(**settings: Any) -> TD:
    return td(trace="replacing", **settings)


def sarsa(**settings: Any) -> Sarsa:
    return Sarsa(actions=2, **settings)


def true_online_sarsa(**settings: Any) -> TrueOnlineSarsa:
    return TrueOnlineSarsa(actions=2, **settings)


def q(**settings: Any) -> QLearning:
    return QLearning(actions=2, **{"lambda_": 0.8} | settings)


def expected_sarsa(**settings: Any) -> ExpectedSarsa:
    return ExpectedSarsa(actions=2, policy=EpsilonGreedy(), **{"lambda_": 0.8} | settings)


def swift(**settings: Any) -> SwiftTD:
    return SwiftTD(**{"alpha": 0.02, "meta_step_size": 0.01} | settings)


MAKERS: dict[str, Make] = {
    "TD": td,
    "TD, replacing": replacing,
    "true online TD": true_online_td,
    "SARSA": sarsa,
    "true online SARSA": true_online_sarsa,
    "Q": q,
    "expected SARSA": expected_sarsa,
    "SwiftTD": swift,
}


def experience(rng: Generator, length: int, *, real: bool = False) -> Iterator[Transition]:
    """Wander over sets of active features; episodes end now and then, in both ways."""
    active = rng.permutation(SIZE)[:ACTIVE]
    before = vector(rng, active, real)
    for time in range(length):
        active = rng.permutation(SIZE)[:ACTIVE] if rng.random() < 0.01 else drift(rng, active)
        after = vector(rng, active, real)
        end = rng.random()
        reward, actions = math.sin(time / 30) + rng.normal(), rng.integers(2, size=2).tolist()
        yield Transition(before, actions[0], 1.0, reward, after, actions[1], 0, end < 0.01, 0.01 < end < 0.02)
        before = after


def drift(rng: Generator, active: np.ndarray) -> np.ndarray:
    """Replace up to three features."""
    new = np.setdiff1d(rng.integers(SIZE, size=rng.integers(4)), active)
    return np.concatenate((rng.permutation(active)[: ACTIVE - new.size], new))


def vector(rng: Generator, active: np.ndarray, real: bool) -> FeatureVector:
    return FeatureVector(np.sort(active), rng.uniform(-1, 2, active.size) if real else None)


def both_forms(make: Make, **settings: Any) -> tuple[Any, Any]:
    """Return the compiled learner and the plain one."""
    compiled = make(size=SIZE, active=ACTIVE, **settings)
    with kernels.plain():
        return compiled, make(size=SIZE, active=ACTIVE, **settings)


def parts(learner: Any) -> Any:
    return next(value for name, value in vars(learner).items() if name in ("_theta", "_q", "_swift"))


def values(learner: Any, features: FeatureVector) -> np.ndarray:
    control = hasattr(learner, "action_values")
    return np.atleast_1d(learner.action_values(features) if control else learner.predict(features))


def as_text(saved: Saved) -> str:
    """Write what was saved out, to the last bit of every number."""
    return json.dumps(saved, default=lambda array: array.tolist())


def learn_all(learner: Any, transitions: Iterable[Transition]) -> None:
    for t in transitions:
        learner.update(t)


def disagreement(make: Make, length: int, *, real: bool = False, seed: int = 0, **settings: Any) -> float:
    """Return how far the predictions of both forms come apart, relative to the largest."""
    compiled, plain = both_forms(make, **settings)
    assert isinstance(parts(compiled), LazyTraces | SparseSwift)
    assert not isinstance(parts(plain), LazyTraces | SparseSwift)
    worst = largest = 0.0
    known = list(experience(np.random.default_rng(seed), min(length, 5000), real=real))
    for step, t in enumerate(itertools.islice(itertools.cycle(known), length)):
        compiled.update(t)
        plain.update(t)
        if length > len(known) and step % 20:
            continue
        one, other = values(compiled, t.next_features), values(plain, t.next_features)
        worst, largest = max(worst, float(np.abs(one - other).max())), max(largest, float(np.abs(other).max()))
    np.testing.assert_allclose(compiled.weights, plain.weights, rtol=0, atol=1e-9 * np.abs(plain.weights).max())
    assert largest > 0.1
    return worst / largest


def test_both_forms_predict_the_same_over_100_000_steps() -> None:
    assert disagreement(true_online_td, 100_000) < 1e-9


@pytest.mark.parametrize("real", [False, True], ids=["binary", "real"])
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_both_forms_predict_the_same(make: Make, real: bool) -> None:
    assert disagreement(make, 1500, real=real, alpha=0.05) < 1e-9


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_both_forms_predict_the_same_where_gamma_and_lambda_depend_on_the_state(make: Make) -> None:
    assert disagreement(make, 1500, seed=1, **BY_STATE) < 1e-9


@pytest.mark.parametrize("rates", [(1.0, 1.0), (0.9999, 1.0), (0.3, 0.3), (0.9, 0.0), (0.0, 0.9)])
def test_both_forms_predict_the_same_at_the_ends_of_gamma_and_lambda(rates: tuple[float, float]) -> None:
    assert disagreement(true_online_td, 1500, alpha=0.02, gamma=rates[0], lambda_=rates[1]) < 1e-9
    assert disagreement(replacing, 1500, alpha=0.01, gamma=rates[0], lambda_=rates[1]) < 1e-9


# The arrays themselves

operations = st.lists(
    st.tuples(
        st.sampled_from(["accumulate", "replace", "dutch", "reset"]),
        st.integers(0, 2),
        st.lists(st.tuples(st.integers(0, 5), st.sampled_from([1.0, -1.0, 0.0, 0.25])), max_size=6),
        st.floats(-2, 2),
        st.sampled_from([0.0, 1e-9, 0.5, 0.9, 1.0]),
    ),
    max_size=40,
)


@given(operations)
@settings(max_examples=200)
def test_any_sequence_of_steps_leaves_the_same_weights_and_the_same_trace(sequence: list[Any]) -> None:
    lazy, dense = LazyTraces(3, 6, 0.5, linear), DenseTraces(3, 6, 0.5)
    for name, row, active, target, decay in sequence:
        chosen = dict(active)
        features = FeatureVector(np.array(list(chosen), dtype=np.intp), np.array(list(chosen.values())))
        deltas = [apply(form, name, row, features, target, decay) for form in (lazy, dense)]
        assert deltas[0] == pytest.approx(deltas[1], rel=1e-9, abs=1e-9)
        np.testing.assert_allclose(lazy.weights, dense.weights, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(trace_of(lazy), trace_of(dense), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(lazy.values(features), dense.values(features), rtol=1e-9, atol=1e-9)
        assert lazy.value(row, features) == pytest.approx(dense.values(features)[row], rel=1e-9, abs=1e-9)


def apply(form: Traces, name: str, row: int, features: FeatureVector, target: float, decay: float) -> float:
    if name == "reset":
        form.reset()
        return 0.0
    if name == "dutch":
        return form.dutch(row, features, 0, features, target, 0.7, target / 2, 0.1, decay)[0]
    return form.credit(row, features, target, 0.1, decay, replacing=name == "replace")


def trace_of(form: Traces) -> np.ndarray:
    saved = form.save()
    trace: np.ndarray = saved["scale"] * saved["trace"]
    return trace


def test_a_trace_that_has_faded_is_forgotten_so_that_a_fold_costs_only_what_was_visited_lately() -> None:
    lazy = LazyTraces(1, 1000, 0.0, linear)
    for first in range(0, 1000, 10):
        for _ in range(20):
            lazy.credit(0, FeatureVector(np.arange(first, first + 10)), 1.0, 0.01, 0.5)
    assert np.count_nonzero(lazy.save()["trace"]) <= 50
    assert np.count_nonzero(lazy.weights) == 1000


@pytest.mark.parametrize("make", [make for name, make in MAKERS.items() if name != "SwiftTD"])
def test_where_an_update_is_suspended_changes_no_bit_of_what_is_predicted_or_learned(make: Make) -> None:
    size, active, rng = 4 * linear.BLOCK, 3000, np.random.default_rng(8)
    whole, sliced, saved = (make(size=size, active=active, gamma=0.5, lambda_=0.5) for _ in range(3))
    suspended, before = 0, vector(rng, rng.permutation(size)[:active], real=True)
    for _ in range(40):
        after = vector(rng, rng.permutation(size)[:active], real=True)
        t = Transition(
            before, int(rng.integers(2)), 1.0, rng.normal(), after, int(rng.integers(2)), 0, False, False
        )
        whole.update(t)
        saved.update(t)
        for _ in sliced.updating(t):
            suspended += 1
            assert values(sliced, after).tobytes() == values(whole, after).tobytes()
            saved.save()
            assert values(saved, after).tobytes() == values(whole, after).tobytes()
        before = after
    assert suspended >= 3
    assert whole.weights.tobytes() == sliced.weights.tobytes() == saved.weights.tobytes()


def test_an_update_in_slices_returns_its_delta() -> None:
    (t,) = experience(np.random.default_rng(1), 1)
    for learner, other in zip(both_forms(td), both_forms(td), strict=True):
        with pytest.raises(StopIteration) as ended:
            next(learner.updating(t))
        assert ended.value.value == other.update(t) != 0.0


@pytest.mark.parametrize(
    ("rows", "size", "active", "form"),
    [
        (1, 8000, 200, LazyTraces),
        (4, 250, 8, LazyTraces),
        (1, 5, 2, DenseTraces),
        (4, 4999, 1, DenseTraces),
        (4, 5000, 1, LazyTraces),
    ],
)
def test_the_compiled_form_is_taken_where_it_is_worth_it(rows: int, size: int, active: int, form: type) -> None:
    assert isinstance(make_traces(rows, size, 0.0, active), form)
    assert isinstance(make_traces(rows, size, 0.0, 0), DenseTraces)
    with kernels.plain():
        assert isinstance(make_traces(rows, size, 0.0, active), DenseTraces)


def test_a_table_that_is_not_large_never_imports_the_compiler() -> None:
    program = """
import sys
from helpers import step
from rtagent.learning import Sarsa
learner = Sarsa(size=9_999, actions=2, active=1)
learner.update(step(0, 0, 1.0, 1, 1))
assert "numba" not in sys.modules
Sarsa(size=10_000, actions=2, active=1)
assert "numba" in sys.modules
"""
    subprocess.run([sys.executable, "-c", program], cwd=ROOT / "tests", check=True)


@pytest.mark.parametrize("lambda_", [0.0, 0.5])
def test_the_plain_form_is_bit_for_bit_the_same_whether_it_touches_all_or_only_what_is_active(
    lambda_: float,
) -> None:
    touching, whole = DenseTraces(1, 8, 0.1), DenseTraces(1, 8, 0.1)
    for indices in ([0, 3], [3, 4], [7], [0, 1, 2]):
        whole._empty = False
        for form in (touching, whole):
            form.credit(0, FeatureVector(np.array(indices)), 1.0, 0.3, 0.9 * lambda_)
    assert touching.weights.tobytes() == whole.weights.tobytes()


# Saving


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "plain"])
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize("lambda_", [0.05, 0.9])
def test_what_is_restored_in_the_middle_of_an_episode_goes_on_exactly(
    make: Make, compiled: bool, lambda_: float
) -> None:
    (learner, other), (fresh, other_fresh) = both_forms(make, lambda_=lambda_), both_forms(make, lambda_=lambda_)
    if not compiled:
        learner, fresh = other, other_fresh
    first, *rest = np.array_split(np.array(list(experience(np.random.default_rng(2), 240)), dtype=object), 2)
    learn_all(learner, first)
    saved = learner.save()
    learn_all(fresh, experience(np.random.default_rng(9), 50))  # what it was before is of no matter
    fresh.restore(saved)
    assert [learner.update(t) for t in rest[0]] == [fresh.update(t) for t in rest[0]]
    assert learner.weights.tobytes() == fresh.weights.tobytes()


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_what_one_form_has_saved_the_other_goes_on_with(make: Make) -> None:
    compiled, plain = both_forms(make)
    transitions = list(experience(np.random.default_rng(3), 200))
    learn_all(compiled, transitions[:100])
    for taker, giver in ((plain, compiled), (both_forms(make)[0], plain)):
        taker.restore(giver.save())
        for t in transitions[100:]:
            assert taker.update(t) == pytest.approx(giver.update(t), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_what_is_saved_stays_as_it_was_and_holds_nothing_but_arrays_and_numbers(make: Make) -> None:
    for learner in both_forms(make):
        transitions = list(experience(np.random.default_rng(4), 60))
        learn_all(learner, transitions[:30])
        saved = learner.save()
        before = as_text(saved)
        learn_all(learner, transitions[30:])
        assert as_text(saved) == before


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_a_saved_state_of_something_else_is_refused_and_changes_nothing(make: Make) -> None:
    for learner, other in zip(
        both_forms(make), (make(size=SIZE + 1, active=ACTIVE), make(size=7, active=3)), strict=True
    ):
        learn_all(learner, experience(np.random.default_rng(5), 20))
        before = as_text(learner.save())
        with pytest.raises(SpecError, match="other settings"):
            learner.restore(other.save())
        with pytest.raises(SpecError, match="saved state"):
            learner.restore({})
        assert as_text(learner.save()) == before


# Bad input


def spoilt(t: Transition, how: str) -> Transition:
    """Return the transition with something wrong in it."""
    wrong = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
    where, what = how.split(" ")
    if where == "reward":
        return Transition(t.features, 0, 1.0, wrong[what], t.next_features, 0, 0, False, False)
    spoilt_values = np.ones(ACTIVE)
    spoilt_values[3] = wrong[what]
    if where == "feature":
        features = t.features._replace(values=spoilt_values)
        return Transition(features, 0, 1.0, t.reward, t.next_features, 0, 0, False, False)
    following = t.next_features._replace(values=spoilt_values)
    return Transition(t.features, 0, 1.0, t.reward, following, 0, 0, False, False)


@pytest.mark.parametrize("what", ["nan", "inf", "-inf"])
@pytest.mark.parametrize("where", ["reward", "feature", "next"])
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_what_is_not_finite_never_reaches_a_weight(make: Make, where: str, what: str) -> None:
    for learner in both_forms(make):
        *before, last = experience(np.random.default_rng(6), 30)
        learn_all(learner, before)
        state = as_text(learner.save())
        with pytest.raises(SpecError, match=rf"{where}.* is {what}, so nothing was learned"):
            learner.update(spoilt(last, f"{where} {what}"))
        assert as_text(learner.save()) == state
        assert math.isfinite(learner.update(last))


def test_an_infinite_feature_does_not_even_cut_a_trace() -> None:
    feature, infinite = FeatureVector(np.array([3, 4])), FeatureVector(np.array([3, 5]), np.array([math.inf, 1.0]))
    for learner in both_forms(q):
        for action, reward in ((0, 1.0), (1, -1.0), (0, 1.0)):
            learner.update(Transition(feature, action, 1.0, reward, feature, None, 0, False, False))
        before = as_text(learner.save())
        with pytest.raises(SpecError, match="feature 3 of the features is inf"):
            learner.update(Transition(infinite, 1, 1.0, 1.0, feature, None, 0, False, False))
        assert as_text(learner.save()) == before


def test_weights_that_grow_beyond_all_bounds_are_told_with_what_to_do() -> None:
    for learner in both_forms(true_online_td, alpha=10.0 * ACTIVE):
        with np.errstate(over="ignore", invalid="ignore"), pytest.raises(SpecError, match="make alpha smaller"):
            learn_all(learner, experience(np.random.default_rng(7), 3000))


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_features_that_there_are_no_weights_for_are_told(make: Make) -> None:
    outside = FeatureVector(np.array([3, SIZE]))
    inside = FeatureVector(np.array([3, 4]))
    for learner in both_forms(make):
        with pytest.raises(SpecError, match=f"no feature {SIZE}"):
            values(learner, outside)
        for features, following in ((outside, inside), (inside, outside)):
            with pytest.raises(SpecError, match=f"no feature {SIZE}"):
                learner.update(Transition(features, 0, 1.0, 1.0, following, 0, 0, False, False))
        assert not learner.weights.any()


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_features_with_another_number_of_values_are_told(make: Make) -> None:
    odd, good = FeatureVector(np.array([3, 4, 5]), np.array([1.0, 2.0])), FeatureVector(np.array([3, 4]))
    for learner in both_forms(make):
        for features, following in ((odd, good), (good, odd)):
            with pytest.raises(SpecError, match="3 active features with 2 values"):
                learner.update(Transition(features, 0, 1.0, 1.0, following, 0, 0, False, False))
        assert not learner.weights.any()


def test_a_negative_index_never_reaches_a_kernel() -> None:
    learner, _ = both_forms(td)
    with pytest.raises(SpecError, match="no feature -1"):
        learner.predict(FeatureVector(np.array([3, -1])))


@pytest.mark.parametrize("make", [sarsa, true_online_sarsa, q, expected_sarsa])
def test_actions_that_are_missing_or_unknown_are_told(make: Make) -> None:
    features = FeatureVector(np.array([3, 4]))
    for learner in both_forms(make):
        with pytest.raises(SpecError, match="needs the actions"):
            learner.update(Transition(features, None, 1.0, 1.0, features, None, 0, False, False))
        with pytest.raises(SpecError, match="no action 7"):
            learner.update(Transition(features, 7, 1.0, 1.0, features, 0, 0, False, False))
        assert not learner.weights.any()


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_arrays_of_any_type_and_layout_and_rewards_of_any_number_type_are_taken(make: Make) -> None:
    compiled, again = make(size=SIZE, active=ACTIVE), make(size=SIZE, active=ACTIVE)
    wide = np.arange(20).reshape(10, 2)
    frozen = np.array([0.5] * 10)
    frozen.flags.writeable = False
    odd = [FeatureVector(wide[:, 0]), FeatureVector(wide[:, 1].astype(np.int32), frozen)]
    plain = [FeatureVector(np.arange(0, 20, 2)), FeatureVector(np.arange(1, 20, 2), np.full(10, 0.5))]
    for reward in (1, np.float64(0.5), True):
        given = Transition(odd[0], 0, 1.0, reward, odd[1], 1, 0, False, False)
        usual = Transition(plain[0], 0, 1.0, float(reward), plain[1], 1, 0, False, False)
        assert compiled.update(given) == again.update(usual)
        odd, plain = odd[::-1], plain[::-1]
    assert compiled.weights.tobytes() == again.weights.tobytes()


def test_a_learner_of_no_size_is_refused() -> None:
    with pytest.raises(SpecError, match="size is 0"):
        TD(size=0)
    with pytest.raises(SpecError, match="actions is 0"):
        Sarsa(size=2, actions=0)
