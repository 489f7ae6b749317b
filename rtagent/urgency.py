"""Which states are urgent: asked of the newest sample, before anything is learned that could wait."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

from rtagent.agent import Agent
from rtagent.errors import ScheduleError, did_you_mean
from rtagent.learn import Learn, When
from rtagent.senses import Senses
from rtagent.task import Task, Urging


@runtime_checkable
class Foretelling(Protocol):
    """A learner that can be asked for one of its predictions by name."""

    @property
    def names(self) -> Sequence[str]:
        """The names of the predictions."""

    def prediction(self, name: str, features: Any) -> float:
        """Return a prediction for a state with these features; raise `SpecError` for an unknown name."""


class Urgency:
    """Says whether the newest state is urgent: by a condition on a sensor or a prediction, else by the task.

    Raises `ScheduleError` where learning waits for calm and nothing says what is urgent.
    """

    def __init__(self, rules: Learn, task: Task, agent: Agent, senses: Senses) -> None:
        self._condition, self._agent, self._senses = rules.urgent, agent, senses
        self._task = task if isinstance(task, Urging) else None
        if rules.when is When.CALM:
            self._check()

    async def __call__(self) -> bool:
        """Ask now."""
        condition = self._condition
        if condition is None:
            return self._task is not None and self._task.urgent(await self._senses.newest())
        if condition.prediction:
            learner, features = self._agent.learner, self._agent.newest_features
            if features is None or not isinstance(learner, Foretelling):
                return False
            return condition.holds(learner.prediction(condition.prediction, features))
        device, _, sensor = condition.signal.partition(".")
        return condition.holds(float((await self._senses.newest())[device].values[sensor]))

    def _check(self) -> None:
        condition = self._condition
        if condition is None:
            if self._task is None:
                raise ScheduleError(
                    "learning waits for calm, but the task does not say what is urgent: give it learn.urgent."
                )
        elif condition.prediction:
            self._check_prediction(condition.prediction)
        else:
            self._senses.check_sensor(condition.signal)

    def _check_prediction(self, name: str) -> None:
        learner = self._agent.learner
        if not isinstance(learner, Foretelling):
            raise ScheduleError(f"learn.urgent asks for the prediction {name!r}, and this learner has no demons.")
        names = learner.names
        if name not in names:
            raise ScheduleError(f"learn.urgent asks for the prediction {name!r}{did_you_mean(name, list(names))}")
