"""Two coders over one state: the features of a control learner, and those of a Horde that learns beside it."""

from __future__ import annotations

from collections.abc import Mapping

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, State
from rtagent.features.coder import FeatureCoder, Moving, Remembering
from rtagent.saving import Saveable, Saved, restore_parts, save_parts


class PairedVector(FeatureVector):
    """The features of control, which carry those of the Horde, `horde`, with them."""

    horde: FeatureVector


class PairedCoder:
    """Codes each state twice; `size` and `active` are those of `control`, and so is what `encode` returns.

    A learner that knows nothing of the Horde takes its vectors as they are. The parts are coders of their own, with
    inputs of their own; `clipped` and `masked` join what they count of each signal, where they count it: a value
    that both clip is one.
    """

    def __init__(self, control: FeatureCoder, horde: FeatureCoder) -> None:
        if any(isinstance(each, Moving) for each in (control, horde)):
            raise SpecError(
                "prototypes that move are for one learner, and here a Horde learns beside control: "
                "take another coder for both, such as selective_kanerva."
            )
        self.control, self.horde = control, horde
        self.size, self.active = control.size, control.active

    def begin(self) -> None:
        """Begin an episode."""
        for coder in (self.control, self.horde):
            if isinstance(coder, Remembering):
                coder.begin()

    def encode(self, state: State) -> PairedVector:
        """Return both features of `state`; raise `SpecError` as the parts do."""
        paired = PairedVector(*self.control.encode(state))
        paired.horde = self.horde.encode(state)
        return paired

    @property
    def clipped(self) -> Mapping[str, int]:
        """How many values were clipped to their range, by signal."""
        return self._counted("clipped")

    @property
    def masked(self) -> Mapping[str, int]:
        """How many values were disregarded, by signal."""
        return self._counted("masked")

    def save(self) -> Saved:
        """Return the states of those parts that have any."""
        return save_parts(self._parts)

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where it is of something else."""
        restore_parts(self._parts, saved)

    @property
    def _parts(self) -> dict[str, Saveable]:
        parts = {"control": self.control, "horde": self.horde}
        return {name: coder for name, coder in parts.items() if isinstance(coder, Saveable)}

    def _counted(self, kind: str) -> Mapping[str, int]:
        counts: dict[str, int] = {}
        for coder in (self.horde, self.control):
            counts |= getattr(coder, kind, {})
        return counts
