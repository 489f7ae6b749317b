"""The task of Hallway-World (thesis, section 3.2): to the goal quickly, without touching the walls."""

from __future__ import annotations

from collections.abc import Mapping

from rtagent.experience import Command, Observation, Outcome, Stimulus
from rtagent.saving import Saved
from rtagent.specs import DeviceSpec, Spec
from rtagent.task import RewardMeter, require

UP, LEFT = 0, 1


class HallwayTask:
    """Go up the hallway until the wall on the left ends, then left (thesis, figure 3.1)."""

    actions = ("up", "left")

    def __init__(self, *, hallway: str = "hallway") -> None:
        self._hallway = hallway
        self.state = {"wall_left": Spec.flag()}
        self._commands: tuple[Mapping[str, Command], ...] = tuple(
            {hallway: {"move": action}} for action in (UP, LEFT)
        )
        self._reward = RewardMeter()

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None:
        """Check that the hallway is there; raise `SpecError`."""
        require(devices, self._hallway, ("wall_left", "arrived", "reward"), ("move",))

    def begin(self) -> None:
        """Begin an episode."""
        self._reward.begin()

    def interpret(self, observation: Observation) -> Outcome:
        """Return whether there is a wall on the left; the episode ends at the goal."""
        values = observation.samples[self._hallway].values
        reward = self._reward.since_last(values["reward"])
        return Outcome((float(values["wall_left"]),), reward, bool(values["arrived"]))

    def commands(self, action: int) -> Mapping[str, Command]:
        """Return the move command of an action."""
        return self._commands[action]

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        """Say that left is the correct answer."""
        return action == LEFT

    def save(self) -> Saved:
        """Return what was earned in the episode so far."""
        return self._reward.save()

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned in the middle of an episode."""
        self._reward.restore(saved)
