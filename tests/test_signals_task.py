"""The task that only observes: which signals it finds, what it calls them, and when an episode is over."""

from __future__ import annotations

import numpy as np
import pytest

from rtagent.errors import SpecError
from rtagent.experience import Observation, Sample, Values
from rtagent.specs import DeviceSpec, Spec
from rtagent.tasks import Signals

UNIT = Spec(low=0.0, high=1.0)
DEVICES = {
    "arm": DeviceSpec(
        sensors={
            "load": UNIT,
            "pose": Spec(shape=(2,)),
            "grip": Spec.discrete(3),
            "touch": Spec.flag(),
            "ended": Spec.flag(),
        }
    ),
    "leg": DeviceSpec(sensors={"load": Spec(low=-1.0, high=1.0), "ended": UNIT}),
}


def bound(*signals: str, reward: str = "") -> Signals:
    task = Signals(signals=signals, reward=reward)
    task.bind(DEVICES)
    task.begin()
    return task


def seen(**values: Values) -> Observation:
    return Observation(0, {device: Sample(each, 0, 0, 0) for device, each in values.items()})


ARM: Values = {"load": 0.5, "pose": np.zeros(2), "grip": 2, "touch": True, "ended": False}
LEG: Values = {"load": -0.5, "ended": 1.0}


def test_every_number_is_a_signal_with_its_own_spec() -> None:
    task = bound()
    assert list(task.state) == ["arm.load", "grip", "leg.load", "ended"]
    assert task.state["leg.load"] is DEVICES["leg"].sensors["load"]
    assert task.interpret(seen(arm=ARM, leg=LEG)) == ((0.5, 2.0, -0.5, 1.0), 0.0, False, False)
    assert (task.actions, task.commands(0)) == ((), {})


def test_patterns_pick_signals_in_the_order_of_the_devices() -> None:
    assert list(bound("*.touch", "arm.load").state) == ["load", "touch"]
    assert bound("*.touch", "arm.load").interpret(seen(arm=ARM, leg=LEG)).state == (0.5, 1.0)
    assert list(bound("*.load").state) == ["arm.load", "leg.load"]


def test_only_a_flag_called_ended_ends_the_episode() -> None:
    task = bound("arm.load")
    assert not task.interpret(seen(arm=ARM, leg=LEG)).truncated
    outcome = task.interpret(seen(arm={**ARM, "ended": True}, leg=LEG))
    assert (outcome.truncated, outcome.terminated) == (True, False)


def test_a_sensor_can_be_the_reward() -> None:
    assert bound(reward="leg.load").interpret(seen(arm=ARM, leg=LEG)).reward == -0.5


@pytest.mark.parametrize(
    ("signals", "reward", "sentence"),
    [
        (["arm.lod"], "", "did you mean 'arm.load'"),
        (["load"], "", "'load' matches no signal"),
        (["*.pose"], "", "matches no signal"),
        (["arm.ended"], "", "matches no signal"),
        ([], "load", "reward is 'load', which is no device.sensor: did you mean"),
        ([], "arm.pose", "reward is 'arm.pose', which is no device.sensor"),
    ],
)
def test_what_is_not_there_is_told(signals: list[str], reward: str, sentence: str) -> None:
    with pytest.raises(SpecError) as caught:
        bound(*signals, reward=reward)
    assert sentence in str(caught.value)


def test_devices_without_a_number_are_told() -> None:
    with pytest.raises(SpecError, match="no device senses a number"):
        Signals().bind({"button": DeviceSpec(sensors={"down": Spec.flag()})})
