"""Control with a Horde beside it: an agent that acts, and predicts what its devices will sense."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.features.paired import PairedVector
from rtagent.learning.horde import Horde
from rtagent.learning.learner import ControlLearner, SlicedLearner
from rtagent.learning.returns import PredictionErrors
from rtagent.saving import Saveable, Saved, restore_parts, save_parts


class WithHorde:
    """A control learner and a Horde that learn from the same transitions, each from features of its own.

    The features are those of a `PairedCoder`. Of each transition the control learner learns first, in one slice
    unless it is sliced itself: what is chosen while the Horde still learns has all of it. Where the Horde refuses a
    transition (`SpecError`), the control learner has learned it.
    """

    def __init__(self, control: ControlLearner, horde: Horde) -> None:
        if not hasattr(control, "action_values"):
            raise SpecError(
                f"a Horde learns beside a learner that controls, and {type(control).__name__} values no actions: "
                "take one for control, such as sarsa, or let the Horde be the learner of a run that only predicts."
            )
        self.control, self.horde = control, horde
        self.needs_next_action = control.needs_next_action

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return the estimated return of every action, shape (actions,)."""
        return self.control.action_values(features)

    @property
    def names(self) -> Sequence[str]:
        """The names of the demons, in their order."""
        return self.horde.names

    def prediction(self, name: str, features: FeatureVector) -> float:
        """Return the prediction of the demon of this name; raise `SpecError` where there is none."""
        return self.horde.prediction(name, _of_horde(features))

    def update(self, transition: Transition) -> float:
        """Learn a transition; return the delta of control."""
        delta = self.control.update(transition)
        self.horde.update(_for_horde(transition))
        return delta

    def updating(self, transition: Transition) -> Generator[bool | None, None, float]:
        """Do what `update` does, in slices; those of the Horde leave the action values alone."""
        if isinstance(self.control, SlicedLearner):
            delta = yield from self.control.updating(transition)
        else:
            delta = self.control.update(transition)
        yield True
        for _ in self.horde.updating(_for_horde(transition)):
            yield True
        return delta

    def errors(self) -> Mapping[str, PredictionErrors]:
        """Return the errors of the measured demons, by their names."""
        return self.horde.errors()

    def save(self) -> Saved:
        """Return the states of both; not to be called in the middle of an update."""
        return save_parts(self._parts)

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where it is of something else."""
        restore_parts(self._parts, saved)

    @property
    def _parts(self) -> dict[str, Saveable]:
        return {"horde": self.horde} | ({"control": self.control} if isinstance(self.control, Saveable) else {})


def _for_horde(t: Transition) -> Transition:
    """Return a transition with the features of the Horde."""
    return replace(t, features=_of_horde(t.features), next_features=_of_horde(t.next_features))


def _of_horde(features: FeatureVector) -> FeatureVector:
    if isinstance(features, PairedVector):
        return features.horde
    raise SpecError("the features hold none for the Horde: give the agent a PairedCoder.")
