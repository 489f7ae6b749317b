"""Which states are urgent: asked of the newest sample, before anything is learned that could wait."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from rtagent.agent import Agent
from rtagent.errors import ScheduleError, did_you_mean
from rtagent.learn import Learn, When
from rtagent.senses import Senses
from rtagent.specs import DeviceSpec
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
    """Says whether the newest state is urgent: by a condition on a sensor or a prediction, else by the task."""

    def __init__(self, rules: Learn, task: Task, agent: Agent, senses: Senses) -> None:
        self._condition, self._agent, self._senses = rules.urgent, agent, senses
        self._task = task if isinstance(task, Urging) else None
        self.by_prediction = rules.urgent is not None and bool(rules.urgent.prediction)
        """Whether only an observation, and no sample alone, can become urgent."""

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


def check_urgency(rules: Learn, task: Task, learner: object, devices: Mapping[str, DeviceSpec]) -> None:
    """Raise `ScheduleError` where learning waits for calm and nothing says what is urgent, or a name is unknown."""
    condition = rules.urgent
    if condition is None:
        if rules.when is When.CALM and not isinstance(task, Urging):
            raise ScheduleError(
                "learning waits for calm, but the task does not say what is urgent: give it learn.urgent."
            )
    elif condition.prediction:
        _check_prediction(condition.prediction, learner)
    else:
        _check_signal(condition.signal, devices)


def _check_prediction(name: str, learner: object) -> None:
    if not isinstance(learner, Foretelling):
        raise ScheduleError(f"learn.urgent asks for the prediction {name!r}, and this learner has no demons.")
    names = list(learner.names)
    if name not in names:
        raise ScheduleError(f"learn.urgent: there is no prediction {name!r}{did_you_mean(name, names)}")


def _check_signal(signal: str, devices: Mapping[str, DeviceSpec]) -> None:
    known = [
        f"{device}.{name}"
        for device, spec in devices.items()
        for name, sensor in spec.sensors.items()
        if not sensor.shape
    ]
    if signal not in known:
        raise ScheduleError(f"learn.urgent: there is no signal {signal!r}{did_you_mean(signal, sorted(known))}")
