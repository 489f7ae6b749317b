"""A recording as a world: its own times under either clock, every row once, nothing mended, all of it told."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import one_hot, virtually
from hypothesis import given
from hypothesis import strategies as st

from rtagent import Agent, Plan, Result, RunError, Schedule, clock, ms, run, second
from rtagent.clock import ClockName
from rtagent.costs import Cost
from rtagent.device import Device
from rtagent.errors import DisconnectedError, SpecError
from rtagent.experience import FeatureVector, Sample, State, Transition
from rtagent.schedule import LEARN, OBSERVE
from rtagent.tasks import Signals
from rtagent.testing import DeviceContract
from rtagent_drivers.recorded import Signal, recording_of
from rtagent_drivers.recording import ArmRecording, RecordingDevice, recording
from rtagent_drivers.tables import Table, write_table

NAN = float("nan")
LONG = 3600 * second


def table(times: Sequence[float], sessions: Sequence[str] | None = None, **columns: Sequence[float]) -> Table:
    numbers = {name: np.array(column, dtype=np.float64) for name, column in columns.items()}
    return Table(np.array(times, dtype=np.float64), list(sessions or [""] * len(times)), numbers)


def played(given: Table, speed: float = 1.0) -> RecordingDevice:
    """Return a device that plays signals whose ranges are 0 to 1000."""
    signals = {name: Signal(low=0.0, high=1000.0) for name in given.columns}
    return RecordingDevice(recording_of(given, "mine", signals), speed)


def counting(rows: int, step: float = 0.1) -> Table:
    return table(np.arange(rows) * step, x=np.arange(rows))


class One:
    """A coder with one feature."""

    size = active = 1

    def encode(self, state: State) -> FeatureVector:
        return one_hot(0)


class Witness:
    """A learner that only keeps what it is given."""

    needs_next_action = False

    def __init__(self) -> None:
        self.transitions: list[Transition] = []

    def predict(self, features: FeatureVector) -> float:
        return 0.0

    def update(self, transition: Transition) -> float:
        self.transitions.append(transition)
        return 0.0


class Looker:
    """An instrument that keeps all samples of the device "arm"."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.times: list[int] = []

    def observed(self, observation: Any, stimuli: object) -> None:
        self.samples.append(observation.samples["arm"])
        self.times.append(observation.time)


def watch(
    devices: Device | Mapping[str, Device],
    *,
    episodes: int = 1,
    clock_name: ClockName = "virtual",
    costs: int = 0,
    observe_timeout: int = LONG,
    reward: str = "",
) -> tuple[Result, list[Transition], Looker]:
    """Only observe and learn, to the end of the recording; `costs` (ns) is what learning costs."""
    witness, looker = Witness(), Looker()

    async def main() -> Result:
        return await run(
            devices if isinstance(devices, dict) else {"arm": devices},  # type: ignore[dict-item]  # it is one
            Signals(reward=reward),
            Agent(One(), witness),
            Schedule((OBSERVE, LEARN), observe_timeout=observe_timeout),
            Plan(episodes=episodes),
            costs={LEARN: Cost(costs)} if costs else None,
            instruments=[looker],
        )

    result = clock.run(main(), clock_name)
    return result, witness.transitions, looker


def long_recording() -> RecordingDevice:
    return played(table(np.arange(5000) * 0.002, x=np.arange(5000) % 1000))


class TestRecording(DeviceContract):
    def make_device(self):  # type: ignore[no-untyped-def]  # as a user would write it
        return long_recording()


class TestRecordingInVirtualTime(TestRecording):
    clock: ClockName = "virtual"


class TestRecordingOfTheArm(DeviceContract):
    clock: ClockName = "virtual"

    def make_device(self):  # type: ignore[no-untyped-def]
        return recording(arm=ArmRecording(duration=second))


# Times


@given(
    steps=st.lists(st.integers(1, 10_000), min_size=1, max_size=40),
    values=st.lists(st.floats(0.0, 1000.0), min_size=41, max_size=41),
    speed=st.sampled_from([0.5, 1.0, 8.0]),
)
def test_every_row_is_seen_once_at_its_own_time(steps: list[int], values: list[float], speed: float) -> None:
    times = np.concatenate([[0], np.cumsum(steps)]) / 1000
    seen = values[: len(times)]
    result, transitions, looker = watch(played(table(times, x=seen), speed))
    assert [sample.values["x"] for sample in looker.samples] == seen
    assert [sample.values["ended"] for sample in looker.samples] == [False] * (len(seen) - 1) + [True]
    assert [sample.sequence for sample in looker.samples] == list(range(len(seen)))
    due = [round(float(time) * second / speed) for time in times]
    assert [time - looker.times[0] for time in looker.times] == due
    assert [sample.world_time for sample in looker.samples] == looker.times
    assert [each.elapsed for each in transitions] == np.diff(due).tolist()
    assert [(each.state[0], each.next_state[0]) for each in transitions] == list(pairwise(seen))
    assert [each.truncated for each in transitions] == [False] * (len(transitions) - 1) + [True]
    assert not any(each.terminated for each in transitions)
    assert result.device_counters["arm"].get("rows_skipped", 0) == 0
    assert result.recorder.counters["observe_timeouts"] == 0


@pytest.mark.parametrize("name", ["mine.csv", "mine.csv.gz", "mine.npz"])
def test_a_file_plays_as_what_was_written(tmp_path: Path, name: str) -> None:
    given_table = table(
        [0.0, 0.1, 0.3, 0.0, 0.2], ["a", "a", "a", "b", "b"], x=[1, NAN, 3, 4, 5.5], y=[1, 2, 3, 4, 5]
    )
    write_table(given_table, tmp_path / name)
    signals = {name: Signal(low=0.0, high=1000.0) for name in given_table.columns}
    _, _, expected = watch(played(given_table), episodes=2)
    _, _, looker = watch(recording(file=str(tmp_path / name), signals=signals), episodes=2)
    assert looker.samples == expected.samples


def test_in_real_time_rows_come_at_their_own_times() -> None:
    result, transitions, looker = watch(played(counting(40, 0.005)), clock_name="real")
    rows = [sample.sequence for sample in looker.samples]
    assert rows == sorted(set(rows))
    assert (rows[0], rows[-1]) == (0, 39)
    # a busy machine may make the loop late, but not the recording
    assert len(rows) + result.device_counters["arm"].get("rows_skipped", 0) == 40
    assert [each.next_state[0] for each in transitions] == rows[1:]
    assert all(sample.world_time <= time for sample, time in zip(looker.samples, looker.times, strict=True))
    stamps = np.array([sample.world_time for sample in looker.samples])
    assert (stamps - stamps[0]).tolist() == [row * 5 * ms for row in rows]
    assert result.episodes[0].truncated


def test_a_slow_loop_skips_rows_and_they_are_counted() -> None:
    result, transitions, _ = watch(played(counting(101)), costs=250 * ms)
    rows = [each.next_state[0] for each in transitions]
    assert rows[:5] == [1.0, 3.0, 6.0, 8.0, 11.0]
    assert rows[-1] == 100.0
    assert result.device_counters["arm"]["rows_skipped"] == 100 - len(rows)


def test_a_loop_that_was_busy_finds_the_newest_row() -> None:
    device = played(counting(100))

    async def main() -> list[int]:
        await device.open()
        found = []
        for now in (0, 50 * ms, 100 * ms, 450 * ms, 2 * second, 100 * second):
            await clock.current().sleep_until(start + now)
            found.append((await device.read(-1)).sequence)
        return found

    start = 5 * second
    assert clock.run(main(), "virtual", start) == [0, 0, 1, 4, 20, 99]


def test_the_next_row_is_foreseen() -> None:
    device = played(table([0, 0.5, 2.0], x=[1, 2, 3]))

    async def main() -> list[int | None]:
        await device.open()
        now = clock.current().now()
        return [
            None if (event := device.next_event(now + time)) is None else event - now
            for time in (0, 499 * ms, 500 * ms, 2 * second)
        ]

    assert virtually(main()) == [500 * ms, 500 * ms, 2 * second, None]


# Sessions


def test_each_session_is_an_episode_and_the_first_follows_the_last() -> None:
    device = played(table([0, 1, 2, 7, 8], ["a", "a", "a", "b", "b"], x=[1, 2, 3, 4, 5]))
    assert device.episodes == 2
    result, transitions, looker = watch(device, episodes=3)
    assert [sample.values["x"] for sample in looker.samples] == [1, 2, 3, 4, 5, 1, 2, 3]
    assert [each.elapsed for each in transitions] == [second] * 5
    assert [(each.steps, each.duration) for each in result.episodes] == [
        (2, 2 * second),
        (1, second),
        (2, 2 * second),
    ]


def test_a_session_of_one_row_is_an_episode_without_a_step() -> None:
    result, transitions, looker = watch(played(table([0, 0, 1], ["a", "b", "b"], x=[1, 2, 3])), episodes=2)
    assert [sample.values["x"] for sample in looker.samples] == [1, 2, 3]
    assert [each.steps for each in result.episodes] == [0, 1]
    assert len(transitions) == 1


# Glitches and gaps


def test_glitches_are_left_out_and_counted() -> None:
    x = [1, -5, 3, 4, NAN, 2000, 7]
    result, transitions, looker = watch(played(table(range(7), x=x, y=[1] * 7)))
    assert [sample.values["x"] for sample in looker.samples] == [1, 3, 4, 7]
    assert [each.elapsed for each in transitions] == [2 * second, second, 3 * second]
    counted = result.device_counters["arm"]
    assert counted == {"x_outside": 2, "x_missing": 1, "invalid_samples": 3}
    assert result.recorder.counters["observe_timeouts"] == 0
    assert {fault.source for fault in result.faults} == {"arm"}
    assert any("sensor 'x': -5.0 is outside its range" in fault.message for fault in result.faults)


@given(st.lists(st.sampled_from([1.0, 2.0, -1.0, NAN]), min_size=1, max_size=12))
def test_whatever_the_rows_are_every_usable_one_is_seen_and_the_end_reached(x: list[float]) -> None:
    usable = [value for value in x if value > 0]
    given_table = table(range(len(x)), x=x)
    if not usable:
        with pytest.raises(SpecError, match=r"nothing to play|no values at all"):
            played(given_table)
        return
    result, transitions, looker = watch(played(given_table))
    assert [sample.values["x"] for sample in looker.samples] == usable
    assert looker.samples[-1].values["ended"]
    assert len(transitions) == len(usable) - 1
    assert result.episodes[0].truncated
    damage = result.device_counters["arm"]
    assert damage.get("x_outside", 0) == x.count(-1.0)
    assert damage.get("x_missing", 0) == sum(map(np.isnan, x))


def test_a_slow_loop_reaches_the_end_where_the_last_rows_are_glitches() -> None:
    result, transitions, _ = watch(played(table(range(8), x=[1, 2, 3, 4, 5, -1, -1, -1])), costs=10 * second)
    assert [each.next_state[0] for each in transitions] == [2.0, 5.0]
    assert result.episodes[0].truncated
    assert result.device_counters["arm"] == {"rows_skipped": 2, "x_outside": 3}


def test_damage_adds_up_over_episodes() -> None:
    device = played(table([0, 1, 2, 0, 1, 9, 10], [*"aaabbbb"], x=[1, -1, 2, -1, 1, 2, NAN]))
    result, _, _ = watch(device, episodes=4)
    counted = result.device_counters["arm"]
    assert counted == {"x_outside": 4, "x_missing": 2, "gaps": 2, "invalid_samples": 2}


def test_a_gap_is_waited_for_and_counted() -> None:
    result, transitions, _ = watch(
        played(table([0, 1, 2, 20_000, 20_001], x=[1, 2, 3, 4, 5])), observe_timeout=LONG * 24
    )
    assert [each.elapsed for each in transitions] == [second, second, 19_998 * second, second]
    assert result.device_counters["arm"] == {"gaps": 1}


def test_glitches_longer_than_observe_waits_are_told_as_time_outs() -> None:
    x = [1.0, *[-1.0] * 50, 2.0]
    result, transitions, looker = watch(played(table(range(52), x=x)), observe_timeout=10 * second)
    assert [(time - looker.times[0]) / second for time in looker.times] == [0, 11, 21, 31, 41, 51]
    assert [sample.values["x"] for sample in looker.samples] == [1.0] * 5 + [2.0]
    assert result.recorder.counters["observe_timeouts"] == 4
    assert sum(each.elapsed for each in transitions) == 51 * second


def test_an_episode_in_which_nothing_usable_comes_in_time_ends_in_a_sentence() -> None:
    class Sleepy(RecordingDevice):
        """A recording whose reader comes late, when a long run of glitches has begun."""

        async def begin_episode(self, rng: np.random.Generator) -> None:
            await super().begin_episode(rng)
            await clock.current().sleep_until(clock.current().now() + 2 * second)

    glitches = played(table(range(60), x=[1.0, *[-1.0] * 58, 2.0]))
    with pytest.raises(RunError, match="gave no valid sample within 500 ms"):
        watch(Sleepy(glitches.recording), observe_timeout=100 * ms)


def test_two_recordings_are_watched_together_glitches_left_out() -> None:
    fast = played(table(np.arange(9) * 0.5, x=[1, 2, -1, 4, 5, 6, 7, 8, 9]))
    slow = played(table([0, 1, 2, 3, 4, 5], x=[10, 20, 30, -1, 50, 60]))
    result, transitions, _ = watch({"arm": fast, "leg": slow})
    assert transitions[0].state == (1.0, 10.0)
    assert {each.next_state for each in transitions} >= {(2.0, 10.0), (4.0, 20.0), (9.0, 50.0)}
    assert result.episodes[0].duration == 4 * second
    assert result.recorder.counters["observe_timeouts"] == 0
    assert (result.device_counters["arm"]["x_outside"], result.device_counters["leg"]["x_outside"]) == (1, 1)


# As a device


def test_nothing_newer_than_the_last_row_ever_comes() -> None:
    device = played(table([0, 1], x=[1, 2]))

    async def main() -> None:
        await device.open()
        assert (await device.read(0)).sequence == 1
        async with asyncio.timeout(1e6):
            await device.read(1)

    with pytest.raises(TimeoutError):
        virtually(main())


def test_a_recording_takes_no_commands() -> None:
    device = played(counting(3))

    async def main() -> None:
        with pytest.raises(DisconnectedError, match="open it first"):
            await device.read(-1)
        await device.open()
        assert await device.act({}) == {}
        with pytest.raises(SpecError, match="a recording can only be watched"):
            await device.act({"x": 1.0})

    virtually(main())


@pytest.mark.parametrize("speed", [0.0, -1.0, NAN, float("inf")])
def test_a_speed_that_is_none_is_refused(speed: float) -> None:
    with pytest.raises(SpecError, match="speed is"):
        played(counting(3), speed)


def test_the_flag_of_the_end_is_no_name_for_a_signal() -> None:
    with pytest.raises(SpecError, match="'ended' is the recording's own flag"):
        played(table([0, 1], ended=[1, 2]))


def test_without_a_file_the_fake_arm_makes_the_recording() -> None:
    device = recording(arm=ArmRecording(duration=10 * second, rate=20.0, joints=2), speed=2.0)
    assert device.spec.rate == 40.0
    assert [name for name in device.spec.sensors if "position" in name] == ["shoulder_position", "elbow_position"]
    assert device.notes == ["the fake arm's recording: 201 rows of 8 signals in 1 session, 10 s, one every 50 ms."]
    some = recording(arm=ArmRecording(duration=second), signals={"angle": Signal("elbow_position", -2.0, 2.0)})
    assert list(some.spec.sensors) == ["angle", "ended"]
