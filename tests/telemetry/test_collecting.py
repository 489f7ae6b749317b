"""What is told of a run is what happened in it, and what is missing is known to the last record."""

from __future__ import annotations

import random
from typing import Any

import msgspec
import numpy as np
import pytest
from collecting import SHORT, assembled, collected
from jsonschema import Draft202012Validator
from parts import ROOT

from rtagent import clock
from rtagent.instruments import Instrument
from rtagent.telemetry.collect import Collector
from rtagent.telemetry.feeding import packed
from rtagent.telemetry.records import STREAMS, Action, Record, schema
from rtagent.telemetry.unpacking import Unpacker

Streams = dict[str, list[Any]]


class Notes(Instrument):
    """Notes what the hooks are called with."""

    def __init__(self) -> None:
        self.observed_: list[Any] = []
        self.acted_: list[Any] = []
        self.learned_: list[Any] = []
        self.reacted_: list[Any] = []
        self.predicted: list[list[float]] = []
        self.spent: dict[str, int] = {}
        self.agent: Any = None

    def trial_began(self, trial: int, agent: Any) -> None:
        self.agent = agent

    def observed(self, observation: Any, stimuli: Any) -> None:
        self.observed_.append((observation, stimuli))

    def acted(self, action: int, sent: Any, start: int, end: int) -> None:
        self.acted_.append((action, sent, start, end))

    def learned(self, transition: Any, delta: float, time: int) -> None:
        self.learned_.append((transition, delta, time))
        self.predicted.append(self.agent.learner.horde.newest.tolist())

    def reacted(self, reaction: Any) -> None:
        self.reacted_.append(reaction)

    def component(self, component: Any, start: int, end: int) -> None:
        self.spent[component.value] = self.spent.get(component.value, 0) + end - start


@pytest.fixture(scope="module")
def told() -> tuple[Streams, Notes]:
    notes = Notes()
    costs = ("costs.learn=100us", "costs.observe=10us", 'devices.joint.onset=["10ms","30ms"]')
    found, _ = collected(assembled(overrides=("run.clock=virtual", "run.episodes=3", *costs)), beside=[notes])
    return found, notes


def test_records_are_numbered_without_a_gap(told: tuple[Streams, Notes]) -> None:
    for stream, records in told[0].items():
        assert [record.sequence for record in records] == list(range(len(records))), stream


def test_samples_and_observations_are_those_of_the_run(told: tuple[Streams, Notes]) -> None:
    found, notes = told
    assert [record.time_ns for record in found["observation"]] == [each.time for each, _ in notes.observed_]
    samples = {(each.device, each.number, each.arrival_time_ns): each for each in found["sample"]}
    assert len(samples) == len(found["sample"]), "each sample is told once"
    for (observation, _), record in zip(notes.observed_, found["observation"], strict=True):
        for device, sample in observation.samples.items():
            told_of = samples[device, sample.sequence, sample.arrival_time]
            assert told_of.values == sample.values
            assert record.samples[device] == sample.sequence


def test_actions_and_transitions_are_those_of_the_run(told: tuple[Streams, Notes]) -> None:
    found, notes = told
    assert [(each.action, each.began_ns, each.time_ns) for each in found["action"]] == [
        (action, start, end) for action, _, start, end in notes.acted_
    ]
    assert [each.sent for each in found["action"]] == [sent for _, sent, _, _ in notes.acted_]
    for record, (transition, delta, time) in zip(found["transition"], notes.learned_, strict=True):
        assert (record.action, record.next_action) == (transition.action, transition.next_action)
        assert (record.reward, record.delta, record.time_ns) == (transition.reward, delta, time)
        assert record.state == list(transition.state)
        assert record.next_state == list(transition.next_state)


def test_predictions_are_in_the_order_of_the_demons(told: tuple[Streams, Notes]) -> None:
    found, notes = told
    by_time = {time: newest for (_, _, time), newest in zip(notes.learned_, notes.predicted, strict=True)}
    assert len(found["prediction"]) > 20
    for record in found["prediction"]:
        np.testing.assert_array_equal(record.values, by_time[record.time_ns])
    assert np.ptp([record.values for record in found["prediction"]], axis=0).max() > 0


def test_the_times_of_components_add_up(told: tuple[Streams, Notes]) -> None:
    found, notes = told
    summed = {name: sum(getattr(record, name) or 0 for record in found["components"]) for name in notes.spent}
    assert summed == notes.spent
    assert summed["learn"] > 0


def test_reactions_have_their_parts(told: tuple[Streams, Notes]) -> None:
    found, notes = told
    assert [each.reaction for each in found["reaction"]] == [each.time for each in notes.reacted_]
    assert len(found["stimulus"]) == len(found["episode"]) == 3


@pytest.mark.parametrize("seed", range(4))
def test_of_what_finds_no_room_the_numbers_are_missing_and_counted(seed: int) -> None:
    rng, whole = random.Random(seed), collected(assembled())[0]
    kept = [rng.random() < 0.5 for _ in range(10_000)]
    found, unpacker = collected(assembled(), lambda number: number < 0 or kept[number])
    assert sum(unpacker.lost.values()) > 50
    for stream, records in whole.items():
        there = found.get(stream, [])
        assert len(there) + unpacker.lost[stream] == len(records)
        for record in there:
            assert without_choice(record) == without_choice(records[record.sequence])


def without_choice(record: Any) -> Any:
    """Return a record without what is known only from the cycle before."""
    known = {"probability": 0, "chosen_ns": None} if isinstance(record, Action) else {}
    return msgspec.structs.replace(record, **known)


@pytest.mark.parametrize("stream", STREAMS)
def test_a_schema_is_an_object_that_needs_no_other(stream: str) -> None:
    made = schema(stream)
    Draft202012Validator.check_schema(made)
    assert made["type"] == "object"
    assert {"sequence", "time_ns"} <= set(made["required"])
    assert f"| `{stream}` |" in (ROOT / "docs" / "telemetry.md").read_text()


def test_records_are_as_their_schemas_say(told: tuple[Streams, Notes]) -> None:
    for stream, records in told[0].items():
        validator = Draft202012Validator(schema(stream))
        for record in records[:20]:
            data = msgspec.json.encode(record)
            validator.validate(msgspec.json.decode(data))
            again: Record = msgspec.json.decode(data, type=STREAMS[stream])
            assert again == record


def test_a_run_with_telemetry_is_the_run_without_it() -> None:
    def weights(run: Any) -> Any:
        notes = Notes()
        run(assembled(), notes)
        return notes.agent.learner.save()

    bare = weights(lambda assembly, notes: clock.run(assembly.run([notes]), "virtual"))
    watched = weights(lambda assembly, notes: collected(assembly, beside=[notes]))
    np.testing.assert_equal(watched, bare)
    assert np.abs(bare["horde"]["0"]["learned"]["total"]).max() > 0


def test_what_was_counted_is_told_as_the_result_tells_it() -> None:
    assembly = assembled(overrides=(*SHORT, "schedule.learn_delay=5ms", "devices.arm.faults.drop=0.5"))
    collector = Collector(list(assembly.task.state), 10**6)
    result = clock.run(assembly.run([collector]), "virtual")
    collector.end("done")
    unpacker = Unpacker(assembly.task.actions)
    for cycle in collector.buffer:
        list(unpacker(packed(cycle)))
    counts = dict(result.recorder.counters)
    for name, of_device in result.device_counters.items():
        counts |= {f"{name}.{what}": count for what, count in of_device.items()}
    assert unpacker.counts == counts
    assert counts["overruns"] > 0
    assert any(name.startswith("arm.") for name in counts)
