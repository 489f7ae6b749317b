"""SwiftTD against its authors' own program, the paper transcribed, steps computed by hand, true online TD."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, Transition
from rtagent.learning import SwiftTD, TrueOnlineTD

SIZES = {"plain": 12, "compiled": 1200}
"""From a thousand weights on the compiled form is taken; the features beyond the first twelve stay silent."""
Experience = tuple[FeatureVector, float]


def stream(length: int, *, real: bool, seed: int = 11) -> Iterator[Experience]:
    """Yield three of twelve features, and the reward that came with them: that of feature 3, and noise."""
    rng = np.random.default_rng(seed)
    for _ in range(length):
        indices = np.sort(rng.permutation(12)[:3])
        values = rng.uniform(0.2, 1.5, 3) if real else None
        yield FeatureVector(indices, values), float(rng.normal() * 0.1 + np.isin(3, indices))


def transitions(experiences: Iterator[Experience]) -> Iterator[Transition]:
    before, _ = next(experiences)
    for after, reward in experiences:
        yield Transition(before, None, 1.0, reward, after, None, 0, False, False)
        before = after


def make(form: str, **changed: Any) -> SwiftTD:
    chosen = {"alpha": 0.05, "gamma": 0.9, "lambda_": 0.8, "eta": 0.1, "epsilon": 0.95, "meta_step_size": 0.01}
    return SwiftTD(size=SIZES[form], active=3, divide_alpha=False, **chosen | changed)


AUTHORS = {
    (False, 0.1): [0.977069, 1.391034, 1.832818, 1.520023, 1.459446, 1.742707],
    (False, 1.0): [1.334837, 1.775084, 2.226039, 1.483577, 1.330176, 1.782606],
    (True, 0.1): [1.098379, 1.516289, 1.8837, 1.355011, 1.398598, 1.686151],
    (True, 1.0): [1.391114, 2.200406, 2.175902, 0.996856, 1.581813, 1.923129],
}
"""By real features and η: what the authors' package (swifttd 0.2.2, in float32) predicts after 50, 100, … steps."""


@pytest.mark.parametrize("form", SIZES)
@pytest.mark.parametrize("case", AUTHORS)
def test_it_predicts_what_the_program_of_its_authors_predicts(form: str, case: tuple[bool, float]) -> None:
    real, eta = case
    learner, found = make(form, eta=eta), []
    for step, transition in enumerate(transitions(stream(301, real=real)), 1):
        learner.update(transition)
        if step % 50 == 0:
            found.append(learner.predict(transition.next_features))
    assert found == pytest.approx(AUTHORS[case], rel=1e-5)


class Paper:
    """The paper's algorithm over dense features, one weight after the other, as it is told there."""

    def __init__(
        self, size: int, alpha: float, gamma: float, lambda_: float, eta: float, epsilon: float, theta: float
    ):
        self.n, self.gamma, self.lambda_ = range(size), gamma, lambda_
        self.eta, self.epsilon, self.theta = eta, epsilon, theta
        self.w, self.h, self.h_old, self.h_temp, self.dw = ([0.0] * size for _ in range(5))
        self.z, self.z_delta, self.z_bar, self.p = ([0.0] * size for _ in range(4))
        self.beta = [math.log(alpha)] * size
        self.v_old = self.v_delta = 0.0

    def perceive(self, phi: list[float], reward: float) -> None:
        v = sum(self.w[i] * phi[i] for i in self.n)
        delta = reward + self.gamma * v - self.v_old
        for i in self.n:
            self.dw[i] = delta * self.z[i] - self.z_delta[i] * self.v_delta
            self.w[i] += self.dw[i]
            self.beta[i] += self.theta / math.exp(self.beta[i]) * (delta - self.v_delta) * self.p[i]
            self.beta[i] = min(self.beta[i], math.log(self.eta))
            self.h_old[i] = self.h[i]
            self.h[i] = self.h_temp[i] + delta * self.z_bar[i] - self.z_delta[i] * self.v_delta
            self.h_temp[i] = self.h[i]
            self.z_delta[i] = 0.0
            for trace in (self.z, self.p, self.z_bar):
                trace[i] *= self.gamma * self.lambda_
        self.v_delta = sum(self.dw[i] * phi[i] for i in self.n)
        rate = sum(math.exp(self.beta[i]) * phi[i] ** 2 for i in self.n)
        b = sum(self.z[i] * phi[i] for i in self.n)
        for i in self.n:
            if phi[i]:
                self.trace(i, phi[i], rate, b)
        self.v_old = v

    def trace(self, i: int, phi: float, rate: float, b: float) -> None:
        self.z_delta[i] = self.eta / max(rate, self.eta) * math.exp(self.beta[i]) * phi
        if rate > self.eta:
            self.h_temp[i] = self.h[i] = self.h_old[i] = self.z_bar[i] = 0.0
            self.beta[i] += math.log(self.epsilon) * phi**2
        self.z[i] += self.z_delta[i] * (1 - b)
        self.p[i] += self.h_old[i] * phi
        self.z_bar[i] += self.z_delta[i] * (1 - b - self.z_bar[i] * phi)
        self.h_temp[i] = (
            self.h[i] - self.h_old[i] * phi * (self.z[i] - self.z_delta[i]) - self.h[i] * self.z_delta[i] * phi
        )


@pytest.mark.parametrize("form", SIZES)
@pytest.mark.parametrize("real", [False, True], ids=["binary", "real"])
@pytest.mark.parametrize("eta", [0.08, 0.3, 3.0])
@pytest.mark.parametrize("lambda_", [0.0, 0.8, 1.0])
def test_it_learns_what_the_paper_says(form: str, real: bool, eta: float, lambda_: float) -> None:
    experiences = list(stream(400, real=real))
    paper = Paper(12, 0.05, 0.9, lambda_, eta, 0.95, 0.01)
    learner = make(form, eta=eta, lambda_=lambda_)
    dense = np.zeros((len(experiences), 12))
    for row, (features, _) in zip(dense, experiences, strict=True):
        row[features.indices] = 1.0 if features.values is None else features.values
    for phi, (_, reward) in zip(dense.tolist(), experiences, strict=True):
        paper.perceive(phi, reward)
    for transition in transitions(iter(experiences)):
        learner.update(transition)
    np.testing.assert_allclose(learner.weights[:12], paper.w, rtol=1e-9, atol=1e-9)
    assert not learner.weights[12:].any()


def test_two_steps_by_hand() -> None:
    learner = SwiftTD(size=1, alpha=0.5, gamma=0.5, lambda_=1.0, eta=0.25, epsilon=0.5, meta_step_size=0.0)
    x = FeatureVector(np.array([0]), np.array([2.0]))
    transition = Transition(x, None, 1.0, 1.0, x, None, 0, False, False)
    # alpha is at most eta, 0.25: the rate of learning is 0.25 * 4 = 1, four times the bound of 0.25
    # z = 0.25 * 0.25 * 2 = 0.125; delta 1; w = 0.125; the step size is multiplied by 0.5 ** 4; z decays to 0.0625
    assert learner.update(transition) == 1.0
    assert learner.weights == pytest.approx(np.array([0.125]))
    assert learner.step_sizes == pytest.approx(np.array([0.25 / 16]))
    # the value was thought to be 0, and is 0.25 now; the rate is 4 / 64, within the bound
    # z = 0.0625 + (2 / 64) (1 - 0.125) = 0.08984375; delta 1 + 0.5 * 0.25 - 0 = 1.125
    # w = 0.125 + 1.125 * 0.08984375 - (2 / 64) * 0.25
    assert learner.update(transition) == pytest.approx(1.125)
    assert learner.weights == pytest.approx(np.array([0.125 + 1.125 * 0.08984375 - 0.25 / 32]))
    assert learner.step_sizes == pytest.approx(np.array([0.25 / 16]))


@pytest.mark.parametrize("form", SIZES)
@given(st.integers(0, 10**6), st.booleans(), st.sampled_from([0.0, 0.5, 0.9, 1.0]))
@settings(max_examples=30)
def test_with_steps_that_never_change_it_is_true_online_td(
    form: str, seed: int, real: bool, lambda_: float
) -> None:
    swift = make(form, lambda_=lambda_, meta_step_size=0.0, eta=100.0)
    true_online = TrueOnlineTD(size=12, alpha=0.05, gamma=0.9, lambda_=lambda_)
    for step, transition in enumerate(transitions(stream(60, real=real, seed=seed))):
        transition.terminated, transition.truncated = step % 20 == 9, step % 20 == 19
        assert swift.update(transition) == pytest.approx(true_online.update(transition), rel=1e-9, abs=1e-9)
    np.testing.assert_allclose(swift.weights[:12], true_online.weights, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("form", SIZES)
@given(st.integers(0, 10**6), st.floats(0.01, 1.0), st.floats(0.001, 10.0))
@settings(max_examples=30)
def test_a_prediction_moves_by_at_most_eta_of_its_error(form: str, seed: int, eta: float, alpha: float) -> None:
    learner = make(form, lambda_=0.0, eta=eta, alpha=alpha)
    for transition in transitions(stream(60, real=True, seed=seed)):
        transition.truncated = True
        before = learner.predict(transition.features)
        delta = learner.update(transition)
        assert abs(learner.predict(transition.features) - before) <= eta * abs(delta) * (1 + 1e-9)
        assert (learner.step_sizes <= eta * (1 + 1e-9)).all()


@pytest.mark.parametrize("form", SIZES)
def test_step_sizes_grow_where_there_is_something_to_learn_and_shrink_where_there_is_none(form: str) -> None:
    """Feature 3 brings a reward that changes its sign now and then; the others are noise."""
    learner = make(form, alpha=0.01, eta=0.5, epsilon=0.999, meta_step_size=0.002, lambda_=0.0, gamma=0.0)
    rng, sign, before = np.random.default_rng(0), 1.0, FeatureVector(np.array([0, 1, 2]))
    for step in range(6000):
        sign = -sign if step % 200 == 0 else sign
        after = FeatureVector(np.sort(rng.permutation(12)[:4]))
        reward = sign * np.isin(3, before.indices) + 0.3 * rng.normal()
        learner.update(Transition(before, None, 1.0, float(reward), after, None, 0, False, True))
        before = after
    sizes = learner.step_sizes[:12]
    assert sizes[3] > 2 * 0.01
    assert np.delete(sizes, 3).max() < 0.01


@pytest.mark.parametrize(
    ("setting", "value"),
    [("eta", 0.0), ("eta", math.nan), ("alpha", 0.0), ("meta_step_size", -1.0), ("meta_step_size", math.inf),
     ("epsilon", 0.0), ("epsilon", 1.5), ("gamma", 2.0), ("lambda_", -1.0)],
)  # fmt: skip
def test_settings_out_of_range_are_refused(setting: str, value: float) -> None:
    with pytest.raises(SpecError, match=f"{setting} is"):
        make("plain", **{setting: value})


def test_a_feature_that_has_faded_is_no_longer_visited() -> None:
    learner = make("compiled", lambda_=0.1)
    for first in range(0, 1100, 3):
        for _ in range(15):
            features = FeatureVector(np.arange(first, first + 3))
            learner.update(Transition(features, None, 1.0, 1.0, features, None, 0, False, False))
    visited = int(learner._swift._cells[-1, learner._swift._kernels.SUPPORT])  # type: ignore[attr-defined]  # it is compiled
    assert 3 <= visited <= 9
    assert np.count_nonzero(learner.weights) == 1101
