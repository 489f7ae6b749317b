"""The task of an operator at a switchboard: put each call through to the outlet that its line is wired for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rtagent.experience import Command, Observation, Outcome, Sample, Stimulus
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import DeviceSpec, Spec, Value
from rtagent.task import RewardMeter, require

STATE = ("line", "lamp", "traffic")


class Switchboard:
    """Put calls through; an action is an outlet, for whichever line rang in the newest observation.

    The state is that line (0: none), the lamp, and the traffic. `outlets` is how many the board has.
    """

    def __init__(self, *, board: str = "board", outlets: int = 4) -> None:
        self._board = board
        self.actions: Sequence[str] = tuple(f"outlet {number}" for number in range(outlets))
        self.state: Mapping[str, Spec] = {}
        self._line: Value = 0
        self._reward = RewardMeter()

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None:
        """Check that the board is there, and take its ranges; raise `SpecError`."""
        require(devices, self._board, (*STATE, "reward"), ("line", "outlet"))
        board = devices[self._board]
        board.actuators["outlet"].validate(len(self.actions) - 1, "outlets, less 1,")
        self.state = {name: board.sensors[name] for name in STATE}

    def begin(self) -> None:
        """Begin an episode."""
        self._line = 0
        self._reward.begin()

    def interpret(self, observation: Observation) -> Outcome:
        """Return what is seen of the board; an episode has no end of its own."""
        values = observation.samples[self._board].values
        self._line = values["line"]
        state = tuple(float(values[name]) for name in STATE)
        return Outcome(state, self._reward.since_last(values["reward"]))

    def urgent(self, samples: Mapping[str, Sample]) -> bool:
        """Say that it is urgent while a call rings."""
        return bool(samples[self._board].values["line"])

    def commands(self, action: int) -> Mapping[str, Command]:
        """Return the command that puts the line through."""
        return {self._board: {"line": self._line, "outlet": action}}

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        """Say whether it is the outlet that the call was for."""
        return stimulus.kind == f"call for outlet {action}"

    def save(self) -> Saved:
        """Return which line rang, and what was earned in the episode so far."""
        return save_fields(self, ("_line",)) | self._reward.save()

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned in the middle of an episode."""
        restore_fields(self, ("_line",), saved)
        self._reward.restore(saved)
