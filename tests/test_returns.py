"""Returns that are known only later: against sums over all that followed, and in bounded memory."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent.learning import returns
from rtagent.learning.returns import SLICE, TOLERANCE, Verifier

Step = tuple[float, float, float, bool]
"""What was predicted, the cumulant and γ that came next, and whether the episode was cut short there."""

STEPS = st.builds(
    lambda steps, times: [(*step[:3], step[3] == 0) for step in steps] * times,
    st.lists(
        st.tuples(
            st.floats(-2, 2), st.floats(-2, 2), st.sampled_from([1.0, 0.99, 0.9, 0.3, 0.0]), st.integers(0, 20)
        ),
        max_size=SLICE,
    ),
    st.integers(1, 8),
)  # fmt: skip


def verified(steps: Sequence[Step], verifier: Verifier | None = None) -> Verifier:
    """Return a verifier of two demons, of which the second predicts and senses twice as much."""
    verifier = verifier or Verifier(2)
    for prediction, cumulant, gamma, last in steps:
        twice = np.array([1.0, 2.0])
        for _ in verifier.add(prediction * twice, cumulant * twice, gamma, last):
            pass
    return verifier


def errors_by_definition(steps: Sequence[Step]) -> list[float | None]:
    """Return the error of each prediction, by a sum over what followed; None where its return is not known."""
    errors: list[float | None] = []
    for number, (prediction, *_) in enumerate(steps):
        total, weight = 0.0, 1.0
        for _, cumulant, gamma, last in steps[number:]:
            total += weight * cumulant
            weight *= gamma
            if last or gamma == 0.0:
                break
        errors.append(prediction - total if weight < TOLERANCE else None)
    return errors


@settings(max_examples=60)
@given(STEPS)
def test_errors_are_those_of_the_definition(steps: list[Step]) -> None:
    """Every return that is known is compared once the episode is over."""
    steps = [*steps, (0.0, 0.0, 1.0, True)]
    found, expected = verified(steps), errors_by_definition(steps)
    known = [error for error in expected if error is not None]
    assert found.verified + found.unverified == len(steps)
    assert found.verified == len(known)
    one, two = found.errors()
    unseen = TOLERANCE * sum(abs(cumulant) for _, cumulant, *_ in steps) + 1e-9
    if known:
        assert one.mae == pytest.approx(np.mean(np.abs(known)), abs=unseen)
        assert one.rmse == pytest.approx(math.sqrt(np.mean(np.square(known))), abs=unseen)
        assert two.mae == pytest.approx(2 * float(one.mae or 0.0))
    else:
        assert (one.mae, one.rmse) == (None, None)


@settings(max_examples=30)
@given(STEPS, st.integers(0, 8 * SLICE))
def test_a_restored_verifier_goes_on_as_if_nothing_had_been(steps: list[Step], place: int) -> None:
    before = verified(steps[:place])
    restored = Verifier(2)
    restored.restore(before.save())
    assert verified(steps[place:], restored).errors() == verified(steps).errors()


def test_a_slice_is_a_block_of_steps() -> None:
    verifier = verified([(0.0, 1.0, 0.999, False)] * 1000)
    slices = sum(1 for _ in verifier.add(np.zeros(2), np.zeros(2), 0.0, True))
    assert slices == math.ceil(1001 / SLICE)


def test_what_waits_too_long_is_given_up_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(returns, "MOST_PENDING", 4 * SLICE)
    verifier = verified([(0.0, 1.0, 1.0, False)] * (12 * SLICE))
    assert (verifier.verified, verifier.unverified) == (0, 8 * SLICE)
