"""The agent: features, learner and policy, and the bookkeeping that turns observations into transitions.

Nothing here waits for anything; the runtime says when each component runs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.random import Generator

from rtagent.checkpoint.plain import (
    restored_features,
    restored_state,
    restored_transition,
    save_features,
    save_state,
    save_transition,
    taken_features,
)
from rtagent.errors import ScheduleError, SpecError
from rtagent.experience import FeatureVector, Move, Outcome, State, Transition
from rtagent.features import FeatureCoder, Moving, Remembering
from rtagent.learning import ControlLearner, Inheriting, PredictionLearner
from rtagent.policy import Policy
from rtagent.saving import Saveable, Saved, restore_parts, save_parts
from rtagent.streams import restored_stream, save_stream


class Decision(NamedTuple):
    """An action, what it was chosen from, and with which probability."""

    state: State
    features: FeatureVector
    observed_at: int
    action: int | None
    probability: float


class Agent:
    """What learns and chooses. Without a policy it only predicts.

    `queue` holds complete transitions that were not learned yet, the oldest first; `not_kept` counts those that
    came while it was told to keep none.
    """

    def __init__(
        self,
        features: FeatureCoder,
        learner: ControlLearner | PredictionLearner,
        policy: Policy | None = None,
        rng: Generator | None = None,
    ) -> None:
        self.features, self.learner, self.policy = features, learner, policy
        self.rng = rng if rng is not None else np.random.default_rng()
        self.queue: deque[Transition] = deque()
        self._moving = features if isinstance(features, Moving) else None
        if self._moving is not None and not isinstance(learner, Inheriting):
            raise SpecError(
                f"prototypes move here, and {type(learner).__name__} cannot hand weights on: give it `inherit`, "
                "or take another coder, such as selective_kanerva."
            )
        self.keeps_transitions = True
        self.not_kept = 0
        self._moves: tuple[Move, ...] = ()
        self.begin()

    def begin(self) -> None:
        """Begin an episode: there is nothing before its first observation."""
        if isinstance(self.features, Remembering):
            self.features.begin()
        self._state: State = ()
        self._features: FeatureVector | None = None
        self._observed_at = 0
        self._reward = 0.0
        self._fresh = False
        self._in_force: Decision | None = None
        self._acted = False
        self._incomplete: Transition | None = None
        self.chosen: Decision | None = None

    @property
    def action_pending(self) -> bool:
        """Whether an action was chosen that has not been handed to the devices."""
        return self.chosen is not None and self.chosen is not self._in_force

    @property
    def step_is_open(self) -> bool:
        """Whether the next observation will close a transition."""
        return self._acted if self.policy is not None else self._features is not None

    @property
    def newest_features(self) -> FeatureVector | None:
        """The features of the newest observation (None before the first)."""
        return self._features

    @property
    def fresh(self) -> bool:
        """Whether there is an observation newer than the last choice."""
        return self._fresh

    @property
    def sees_change(self) -> bool:
        """Whether the newest observation has other features than the one that was chosen from last."""
        chosen, newest = self.chosen, self._features
        return newest is not None and (chosen is None or not _equal(chosen.features, newest))

    @property
    def awaits_next_action(self) -> bool:
        """Whether the newest transition is complete only with the next choice."""
        return self._incomplete is not None

    @property
    def repeats_action(self) -> bool:
        """Whether the pending action, if any, is the one that is in force already."""
        if self.chosen is None or self._in_force is None:
            return self.chosen is self._in_force
        return self.chosen.action == self._in_force.action

    def observe(self, outcome: Outcome, time: int) -> Transition | None:
        """Take an observation made at `time` (ns); return the transition that it closed, if it closed one.

        An observation after an act closes a transition; another one without an act refreshes it. What ends an
        episode always closes one, under the action that is still in force.
        """
        features = self.features.encode(outcome.state)
        if self._moving is not None:
            self._moves += self._moving.take_moves()
        self._reward += outcome.reward
        closed = None
        if self._acted or self._closes(outcome):
            closed = self._close(outcome, features, time)
        elif self._incomplete is not None:
            self._refresh(self._incomplete, outcome, features, time)
        self._state, self._features, self._observed_at, self._fresh = outcome.state, features, time, True
        return closed

    def choose(self) -> Decision:
        """Choose an action from the newest observation; raise `ScheduleError` where there is none newer."""
        if not self._fresh or self.policy is None or self._features is None:
            raise ScheduleError("choose needs an observation newer than the last choice, and a policy.")
        values = self.learner.action_values(self._features)  # type: ignore[union-attr]  # control was checked before
        return self._decide(*self.policy.choose(values, self.rng))

    def follow(self, action: int, probability: float) -> Decision:
        """Take an action that was chosen before, as in a recording; raise `ScheduleError` as `choose` does."""
        if not self._fresh or self._features is None:
            raise ScheduleError("an action that is followed needs an observation newer than the last choice.")
        return self._decide(action, probability)

    def _decide(self, action: int, probability: float) -> Decision:
        features = cast("FeatureVector", self._features)
        chosen = self.chosen = Decision(self._state, features, self._observed_at, action, probability)
        self._fresh = False
        if self._incomplete is not None:
            self._complete(action)
        return chosen

    def _complete(self, next_action: int | None) -> None:
        if self._incomplete is not None:
            self._incomplete.next_action = next_action
            self._enqueue(self._incomplete, self._observed_at)
            self._incomplete = None

    def acted(self) -> None:
        """Note that the chosen action was handed to the devices; without a new choice it is taken again."""
        chosen = self.chosen
        if chosen is not None and chosen is self._in_force and self._features is not None:
            self.chosen = chosen._replace(state=self._state, features=self._features, observed_at=self._observed_at)
            self._complete(chosen.action)
        self._in_force = self.chosen
        self._acted = True

    def _closes(self, outcome: Outcome) -> bool:
        if self.policy is None:
            return self._features is not None
        ends = outcome.terminated or outcome.truncated
        return ends and self._in_force is not None and self._incomplete is None

    def _close(self, outcome: Outcome, features: FeatureVector, time: int) -> Transition:
        before = self._in_force if self._acted and self._in_force else self._standing_decision()
        self._complete(before.action)  # where nothing was chosen since, what was done is the next action
        transition = Transition(
            before.features,
            before.action,
            before.probability,
            self._reward,
            features,
            None,
            time - before.observed_at,
            outcome.terminated,
            outcome.truncated,
            before.state,
            outcome.state,
        )
        self._reward, self._acted = 0.0, False
        if self.learner.needs_next_action and not outcome.terminated:
            self._incomplete = transition
        else:
            self._enqueue(transition, time)
        return transition

    def _standing_decision(self) -> Decision:
        """Return the last observation under the action that is still in force, if any."""
        in_force = self._in_force
        action, probability = (in_force.action, in_force.probability) if in_force else (None, 1.0)
        return Decision(self._state, cast("FeatureVector", self._features), self._observed_at, action, probability)

    def _refresh(self, transition: Transition, outcome: Outcome, features: FeatureVector, time: int) -> None:
        transition.elapsed += time - self._observed_at
        transition.reward += self._reward
        transition.next_features, transition.next_state = features, outcome.state
        transition.terminated, transition.truncated = outcome.terminated, outcome.truncated
        self._reward = 0.0
        if outcome.terminated:
            self._enqueue(transition, time)
            self._incomplete = None

    def _enqueue(self, transition: Transition, time: int) -> None:
        if self.keeps_transitions:
            transition.complete_at = time
            transition.moves, self._moves = self._moves, ()
            self.queue.append(transition)
        else:
            self.not_kept += 1

    # What a checkpoint keeps of it

    def save(self) -> Saved:
        """Return all that it knows, its queue and its open step; raise `SpecError` where a part cannot be saved."""
        return {
            "parts": save_parts(self._parts()),
            "rng": save_stream(self.rng),
            "queue": [save_transition(transition) for transition in self.queue],
            "keeps_transitions": self.keeps_transitions,
            "not_kept": self.not_kept,
            "moves": [list(move) for move in self._moves],
            "step": self._save_step(),
        }

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError`, changing nothing, where it is of another agent."""
        rng, step = restored_stream(saved["rng"]), saved["step"]
        queue = [restored_transition(each) for each in saved["queue"]]
        restore_parts(self._parts(), saved["parts"])
        self.rng.bit_generator.state = rng.bit_generator.state
        self.queue.clear()
        self.queue.extend(queue)
        self.keeps_transitions, self.not_kept = saved["keeps_transitions"], saved["not_kept"]
        self._moves = tuple(Move(*move) for move in saved["moves"])
        self._restore_step(step)

    def break_off(self) -> None:
        """End an episode of which nothing more will be seen: its last transition does not end the return."""
        if self._incomplete is not None:
            self._incomplete.truncated = True
            self.choose()
        elif self.queue and not self.queue[-1].terminated:
            self.queue[-1].truncated = True

    def _parts(self) -> dict[str, Saveable]:
        """Return what of it remembers anything; raise `SpecError` where that cannot be saved."""
        parts: dict[str, object] = {"features": self.features, "learner": self.learner, "policy": self.policy}
        for part in (self.learner, self.features if isinstance(self.features, Remembering) else None):
            if part is not None and not isinstance(part, Saveable):
                raise SpecError(
                    f"{type(part).__name__} remembers and cannot be saved: "
                    "give it save and restore (docs/checkpoints.md)."
                )
        return {name: part for name, part in parts.items() if isinstance(part, Saveable)}

    def _save_step(self) -> Saved:
        return {
            "state": save_state(self._state),
            "features": save_features(self._features),
            "observed_at": self._observed_at,
            "reward": self._reward,
            "fresh": self._fresh,
            "acted": self._acted,
            "in_force": _save_decision(self._in_force),
            "chosen": "in force" if self.chosen is self._in_force else _save_decision(self.chosen),
            "incomplete": None if self._incomplete is None else save_transition(self._incomplete),
        }

    def _restore_step(self, saved: Saved) -> None:
        self._state, self._features = restored_state(saved["state"]), restored_features(saved["features"])
        self._observed_at, self._reward = saved["observed_at"], saved["reward"]
        self._fresh, self._acted = saved["fresh"], saved["acted"]
        self._in_force = _restored_decision(saved["in_force"])
        self.chosen = self._in_force if saved["chosen"] == "in force" else _restored_decision(saved["chosen"])
        incomplete = saved["incomplete"]
        self._incomplete = None if incomplete is None else restored_transition(incomplete)


def _equal(one: FeatureVector, other: FeatureVector) -> bool:
    """Say whether two feature vectors are the same, quickly where they are small."""
    if one.indices.tobytes() != other.indices.tobytes():
        return False
    if one.values is None or other.values is None:
        return one.values is other.values
    return one.values.tobytes() == other.values.tobytes()


def _save_decision(decision: Decision | None) -> Saved | None:
    if decision is None:
        return None
    kept = decision._asdict()
    return kept | {"state": save_state(decision.state), "features": save_features(decision.features)}


def _restored_decision(saved: Mapping[str, Any] | None) -> Decision | None:
    if saved is None:
        return None
    state, features = restored_state(saved["state"]), taken_features(saved["features"])
    return Decision(**{**saved, "state": state, "features": features})
