"""Which states are urgent: asked of the newest sample, before anything is learned that could wait."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol, runtime_checkable

from rtagent.agent import Agent
from rtagent.errors import ScheduleError, did_you_mean
from rtagent.learn import Learn, When
from rtagent.ordering import Gauge
from rtagent.schedule import Schedule
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


class Outlook:
    """How urgent the newest observation is: numbers that are known at once, one for each gauge."""

    def __init__(self, gauges: Sequence[Gauge], task: Task, agent: Agent, senses: Senses) -> None:
        self._agent, self._senses = agent, senses
        self._task = task if isinstance(task, Urging) else None
        self._asked = [self._ask(gauge) for gauge in gauges]

    def __call__(self) -> tuple[float, ...]:
        """Return them; there must be an observation."""
        return tuple(ask() for ask in self._asked)

    def _ask(self, gauge: Gauge) -> Callable[[], float]:
        if gauge.prediction:
            return partial(self._predicted, gauge.prediction)
        return partial(self._sensed, *gauge.signal.split(".", 1)) if gauge.signal else self._said

    def _predicted(self, name: str) -> float:
        learner: Any = self._agent.learner
        return float(learner.prediction(name, self._agent.newest_features))

    def _sensed(self, device: str, sensor: str) -> float:
        return float(self._senses.observed()[device].values[sensor])

    def _said(self) -> float:
        return float(self._task is not None and self._task.urgent(self._senses.observed()))


def check_urgency(schedule: Schedule, task: Task, learner: object, devices: Mapping[str, DeviceSpec]) -> None:
    """Raise `ScheduleError` where learning waits for calm and nothing says what is urgent, or a name is unknown."""
    condition, gauges = schedule.learn.urgent, schedule.ordering.urgency if schedule.ordering else ()
    if condition is None and schedule.learn.when is When.CALM and not isinstance(task, Urging):
        raise ScheduleError(
            "learning waits for calm, but the task does not say what is urgent: give it learn.urgent."
        )
    asked = [("learn.urgent", condition), *(("schedule.ordering.urgency", gauge) for gauge in gauges)]
    for where, each in asked:
        if each is not None and each.prediction:
            _check_prediction(where, each.prediction, learner)
        elif each is not None and each.signal:
            _check_signal(where, each.signal, devices)


def _check_prediction(where: str, name: str, learner: object) -> None:
    if not isinstance(learner, Foretelling):
        raise ScheduleError(f"{where} asks for the prediction {name!r}, and this learner has no demons.")
    names = list(learner.names)
    if name not in names:
        raise ScheduleError(f"{where}: there is no prediction {name!r}{did_you_mean(name, names)}")


def _check_signal(where: str, signal: str, devices: Mapping[str, DeviceSpec]) -> None:
    known = [
        f"{device}.{name}"
        for device, spec in devices.items()
        for name, sensor in spec.sensors.items()
        if not sensor.shape
    ]
    if signal not in known:
        raise ScheduleError(f"{where}: there is no signal {signal!r}{did_you_mean(signal, sorted(known))}")
