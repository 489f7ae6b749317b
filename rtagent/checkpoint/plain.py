"""What an agent experiences, as plain data, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rtagent.experience import FeatureVector, Move, Sample, State, Stimulus, Transition
from rtagent.features.paired import PairedVector
from rtagent.saving import Saved
from rtagent.specs import Value

PLAIN = ("action", "probability", "reward", "next_action", "elapsed", "terminated", "truncated", "complete_at")
"""What of a transition is a number, or none."""


def save_features(features: FeatureVector | None) -> Saved | None:
    """Return features, those of a Horde that they carry included."""
    if features is None:
        return None
    saved: Saved = {"indices": features.indices, "values": features.values}
    if isinstance(features, PairedVector):
        saved["horde"] = save_features(features.horde)
    return saved


def restored_features(saved: Mapping[str, Any] | None) -> FeatureVector | None:
    """Return the features that were saved."""
    if saved is None:
        return None
    if "horde" not in saved:
        return FeatureVector(saved["indices"], saved["values"])
    paired = PairedVector(saved["indices"], saved["values"])
    paired.horde = taken_features(saved["horde"])
    return paired


def taken_features(saved: Mapping[str, Any]) -> FeatureVector:
    """Return the features that were saved, where there are some."""
    features = restored_features(saved)
    assert features is not None, "it was told apart before"
    return features


def save_state(state: State) -> Any:
    """Return the signals of a state."""
    return state if isinstance(state, np.ndarray) else [float(each) for each in state]


def restored_state(saved: Any) -> State:
    """Return the state that was saved."""
    return saved if isinstance(saved, np.ndarray) else tuple(saved)


def save_transition(transition: Transition) -> Saved:
    """Return a transition."""
    return {name: getattr(transition, name) for name in PLAIN} | {
        "features": save_features(transition.features),
        "next_features": save_features(transition.next_features),
        "state": save_state(transition.state),
        "next_state": save_state(transition.next_state),
        "moves": [list(move) for move in transition.moves],
    }


def restored_transition(saved: Mapping[str, Any]) -> Transition:
    """Return the transition that was saved."""
    return Transition(
        features=taken_features(saved["features"]),
        next_features=taken_features(saved["next_features"]),
        state=restored_state(saved["state"]),
        next_state=restored_state(saved["next_state"]),
        moves=tuple(Move(*move) for move in saved["moves"]),
        **{name: saved[name] for name in PLAIN},
    )


def save_sample(sample: Sample | None) -> list[Any] | None:
    """Return a sample."""
    return None if sample is None else [dict(sample.values), *sample[1:]]


def restored_sample(saved: Sequence[Any] | None) -> Sample | None:
    """Return the sample that was saved."""
    if saved is None:
        return None
    values: Mapping[str, Value] = saved[0]
    return Sample(values, *saved[1:])


def restored_stimuli(saved: Sequence[Sequence[Any]]) -> list[Stimulus]:
    """Return the stimuli that were saved as lists."""
    return [Stimulus(*each) for each in saved]
