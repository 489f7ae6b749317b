"""Events: flags that follow from signals, and stimuli where they turn true."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtagent import Schedule
from rtagent.errors import SpecError
from rtagent.events import Event, Flags
from rtagent.experience import Observation, Sample, Stimulus
from rtagent.instruments import Instrument
from rtagent.specs import DeviceSpec, Spec
from rtagent.supervision import Supervision
from rtagent.units import ms
from rtagent_drivers.fake import Sampling
from rtagent_drivers.stopping import stopping_joint
from tests.helpers import run_joint

ARM = DeviceSpec(sensors={"load": Spec(), "picture": Spec(shape=(2,))})


def flags_of(loads: list[float], event: Event) -> tuple[Flags, list[bool]]:
    flags = Flags({"touched": event}, ARM)
    samples = [
        flags(Sample({"load": load, "picture": (0.0, 0.0)}, time, time + 5, time, "arrival"))
        for time, load in enumerate(loads)
    ]
    return flags, [bool(sample.values["touched"]) for sample in samples]


def test_a_flag_by_hand() -> None:
    flags, held = flags_of([0.1, 0.31, 0.27, 0.24, 0.31], Event("load", above=0.3, hysteresis=0.05))
    assert held == [False, True, True, False, True]
    stimuli = flags.stimuli(-1, 10)
    assert [(each.time, each.kind, each.time_source) for each in stimuli] == [
        (1, "touched", "arrival"),
        (4, "touched", "arrival"),
    ]
    assert [each.time for each in flags.stimuli(1, 4)] == [4]


def test_what_is_so_from_the_beginning_has_not_happened() -> None:
    flags, held = flags_of([0.5, 0.5], Event("load", above=0.3))
    assert held == [True, True]
    assert not flags.stimuli(-1, 10)


@given(st.lists(st.floats(-1, 1)), st.floats(-1, 1), st.floats(0, 1))
def test_each_turning_true_is_a_stimulus(loads: list[float], below: float, slack: float) -> None:
    flags, held = flags_of(loads, Event("load", below=below, hysteresis=slack))
    rises = [time for time, (before, after) in enumerate(pairwise(held), 1) if after and not before]
    assert [each.time for each in flags.stimuli(-1, len(loads))] == rises
    for load, flag in zip(loads, held, strict=True):
        assert flag or not load < below
        assert not flag or load < below + slack


@pytest.mark.parametrize(
    ("name", "signal", "sentence"),
    [
        ("touched", "lode", "did you mean 'load'"),
        ("touched", "picture", "no number that is sensed"),
        ("load", "load", "called as a sensor is"),
    ],
)
def test_an_event_that_does_not_fit_is_refused(name: str, signal: str, sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        Flags({name: Event(signal, above=0.0)}, ARM)


@pytest.mark.parametrize(
    ("bounds", "sentence"), [({}, "no bound"), ({"above": 1.0, "hysteresis": -1.0}, "hysteresis")]
)
def test_an_event_without_meaning_is_refused(bounds: dict[str, float], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        Event("load", **bounds)


class Seen(Instrument):
    def __init__(self) -> None:
        self.flags: list[bool] = []
        self.stimuli: list[tuple[str, int, int]] = []

    def observed(self, observation: Observation, stimuli: Sequence[Stimulus]) -> None:
        sample = observation.samples["joint"]
        self.flags.append(bool(sample.values["half_way"]))
        self.stimuli += [(each.kind, each.time, sample.world_time) for each in stimuli]


def test_an_event_is_seen_in_a_run_and_calls_for_a_reaction() -> None:
    seen, joint = Seen(), stopping_joint(onset=(400 * ms, 500 * ms), sampling=Sampling(rate=100.0))
    supervision = {"joint": Supervision(events={"half_way": Event("position", above=0.5)})}
    result = run_joint(Schedule.preset("reactive"), joint=joint, instruments=[seen], supervision=supervision)
    half_way, emergency = seen.stimuli
    assert (half_way[0], emergency[0]) == ("half_way", "emergency")
    assert half_way[1] == half_way[2]
    assert seen.flags == sorted(seen.flags)
    assert set(seen.flags) == {False, True}
    assert result.reaction_time.count == 2
