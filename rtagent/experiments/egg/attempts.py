"""What came of each attempt to stop before the egg: when the button was pressed, when the agent acted, where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rtagent.experience import Observation, Stimulus
from rtagent.recorder import EpisodeRecord
from rtagent.tasks import ArmStopping
from rtagent.tasks.arm_stopping import Seen
from rtagent.units import ms, second

FULL_SPEED = 0.98
"""So much of the speed that was told is the full one."""

FORESIGHT = 100 * ms
"""What was seen is carried on for no longer."""


@dataclass(frozen=True)
class Attempt:
    """One episode: times are in s since the joint would have begun to move, had it had its full speed at once.

    `short` is how far (rad) the joint at rest was from the egg (below 0: beyond where it had been). A time is None
    where it never came.
    """

    condition: str
    pressed: float | None
    acted: float | None
    short: float
    broken: bool

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)


@dataclass
class Looks:
    """What was seen: the joint at first, the last time at its full speed, and last; and the press (ns)."""

    first: Seen | None = None
    fast: Seen | None = None
    newest: Seen | None = None
    pressed: int | None = None

    def since(self, time: int | None, speed: float) -> float | None:
        """Return a time (ns) in s since the joint began, reckoned back from where it went at `speed` (rad/s)."""
        if time is None or self.fast is None or self.first is None:
            return None
        return (time - self.fast.time) / second + (self.first.left - self.fast.left) / speed


class Judge:
    """An instrument that looks where the joint goes, and makes an attempt of each episode."""

    def __init__(self, task: ArmStopping, conditions: Sequence[str]) -> None:
        self.conditions = conditions
        self._task, self._looks = task, Looks()
        self.attempts: list[Attempt] = []

    def episode_began(self, trial: int, episode: int, time: int) -> None:
        """Forget the last one."""
        self._looks = Looks()

    def observed(self, observation: Observation, stimuli: Sequence[Stimulus]) -> None:
        """Look at the joint, and at what was pressed."""
        seen, looks = self._task.seen(observation.samples), self._looks
        looks.first, looks.newest = looks.first or seen, seen
        if seen.speed >= FULL_SPEED * self._task.speed:
            looks.fast = seen
        presses = [stimulus.time for stimulus in stimuli if stimulus.kind == "press"]
        if presses and looks.pressed is None:
            looks.pressed = presses[0]

    @property
    def moving(self) -> bool:
        """Whether the joint moved when it was looked at last."""
        return self._looks.newest is not None and self._looks.newest.speed > 0.0

    def gone(self, now: int) -> float:
        """Return how far the joint should be `now` (ns), in parts of its way to the egg, from where it was seen."""
        looks = self._looks
        if looks.first is None or looks.newest is None:
            return 0.0
        since = min(max(now - looks.newest.time, 0), FORESIGHT) / second
        return 1.0 - (looks.newest.left - looks.newest.speed * since) / looks.first.left

    def episode_ended(self, record: EpisodeRecord) -> None:
        """Judge it."""
        looks, responses, speed = self._looks, record.reactions.responses, self._task.speed
        assert looks.newest is not None, "an episode has an observation"
        acted = looks.pressed + responses[0] if responses and looks.pressed is not None else None
        pressed, left = looks.since(looks.pressed, speed), looks.newest.left
        condition = self.conditions[record.episode]
        self.attempts.append(Attempt(condition, pressed, looks.since(acted, speed), left, left <= 0.0))
