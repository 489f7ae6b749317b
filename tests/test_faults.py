"""Whatever goes wrong, a run ends safely, within its time, and says what happened."""

from __future__ import annotations

import asyncio
import logging
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
from parts import SCENARIOS, run_stopping, sarsa_agent

from rtagent import Agent, Component, Plan, RunError, Schedule, Supervision, Transition, clock, ms, run, second
from rtagent.errors import DeviceError, RunStuckError, ScheduleError
from rtagent.experience import Command, Observation, Outcome, Sample
from rtagent.instruments import Instrument
from rtagent.learning import Sarsa
from rtagent.schedule import ACT, CHOOSE, OBSERVE
from rtagent.tasks import Stopping
from rtagent_drivers.fake import FakeDevice, Faults, Sampling
from rtagent_drivers.stopping import StoppingWorld, stopping_joint

BUDGET = Supervision(timeout=300 * ms)


def with_faults(**faults: object) -> FakeDevice:
    return stopping_joint(faults=Faults(**faults))  # type: ignore[arg-type]  # the names are those of Faults


def is_at_rest(joint: FakeDevice) -> bool:
    assert isinstance(joint.world, StoppingWorld)
    return joint.world._stopped is not None


@pytest.mark.parametrize("clock_name", ["real", "virtual"])
@pytest.mark.slow
def test_a_device_that_raises_once_is_counted_and_the_run_goes_on(clock_name: clock.ClockName) -> None:
    result = run_stopping(joint=with_faults(raise_at=(200 * ms,)), episodes=1, clock_name=clock_name)
    counts = result.device_counters["joint"]
    assert counts["read_errors"] + counts.get("act_errors", 0) == 1
    assert counts["retries"] == 1
    assert len(result.episodes) == 1
    assert not any(fault.fatal for fault in result.faults)
    assert "a fault was injected" in result.faults[0].message


def test_a_device_that_dies_ends_the_run_safely_within_its_budget() -> None:
    joint = with_faults(disconnect=((second,),))
    with pytest.raises(RunError, match=r"device 'joint' has not answered for .* retry budget is 300 ms") as caught:
        run_stopping(joint=joint, supervision={"joint": BUDGET}, episodes=50)
    fatal = [fault for fault in caught.value.result.faults if fault.fatal]
    assert len(fatal) == 1
    assert second + 300 * ms <= fatal[0].time <= second + 300 * ms + 200 * ms  # up to one cycle and one pause more
    assert caught.value.result.not_safe == [
        "device 'joint' could not be made safe: DisconnectedError('the device is unplugged')."
    ]


def test_a_device_that_comes_back_is_opened_again() -> None:
    joint = with_faults(disconnect=((400 * ms, 500 * ms),))
    result = run_stopping(joint=joint, supervision={"joint": BUDGET}, episodes=2)
    assert result.device_counters["joint"]["reopened"] == 1
    assert len(result.episodes) == 2


@pytest.mark.parametrize("clock_name", ["real", "virtual"])
def test_a_device_that_hangs_ends_the_run_safely(clock_name: clock.ClockName) -> None:
    joint = with_faults(hang_at=tuple(range(200 * ms, 210 * ms, ms)))
    with pytest.raises(RunError, match="has not answered") as caught:
        run_stopping(joint=joint, supervision={"joint": BUDGET}, episodes=50, clock_name=clock_name)
    if clock_name == "virtual":
        assert caught.value.result.faults[-1].time <= 210 * ms + 300 * ms + 100 * ms
    assert is_at_rest(joint)
    assert caught.value.result.not_safe == []


class IgnoresCancellation(FakeDevice):
    """Hangs so badly that cancelling it does nothing."""

    hung = False

    async def act(self, command: Command) -> Command:
        self.hung = True
        while True:
            try:
                await asyncio.sleep(10)
            except asyncio.CancelledError:
                continue

    async def make_safe(self) -> None:
        self.safe = True


@pytest.mark.parametrize("clock_name", ["real", "virtual"])
@pytest.mark.slow
def test_not_even_a_device_that_ignores_cancellation_hangs_a_run(clock_name: clock.ClockName) -> None:
    good = stopping_joint()
    joint = IgnoresCancellation(good.world)
    with pytest.raises(RunError, match=r"joint\.act did not return, not even when it was cancelled") as caught:
        run_stopping(joint=joint, supervision={"joint": Supervision(timeout=100 * ms)}, clock_name=clock_name)
    if clock_name == "virtual":
        assert caught.value.result.faults[-1].time <= 200 * ms + second, "its time-out, as long again, and a second"
    assert joint.hung
    assert joint.safe


def test_a_device_without_a_first_sample_is_told() -> None:
    joint = stopping_joint(sampling=Sampling(rate=100.0), faults=Faults(corrupt=1.0))
    with pytest.raises(RunError, match="gave no valid sample within 300 ms") as caught:
        run_stopping(joint=joint, supervision={"joint": BUDGET})
    assert caught.value.result.device_counters["joint"]["invalid_samples"] > 1
    assert caught.value.result.recorder.components["act"].count == 0, "nothing moves before the first sample"


def test_corrupt_samples_never_reach_the_agent() -> None:
    seen: list[float] = []

    class Spy(Instrument):
        def observed(self, observation: Observation, stimuli: object) -> None:
            seen.append(float(observation.samples["joint"].values["position"]))

    joint = stopping_joint(sampling=Sampling(rate=200.0), faults=Faults(corrupt=0.3))
    result = run_stopping(joint=joint, delay=5 * ms, episodes=2, instruments=[Spy()])
    assert result.device_counters["joint"]["invalid_samples"] > 10
    assert all(0.0 <= position <= 10.0 for position in seen)


def test_old_samples_are_marked_stale_and_counted() -> None:
    stale: list[bool] = []

    class Spy(Instrument):
        def observed(self, observation: Observation, stimuli: object) -> None:
            stale.append("joint" in observation.stale)

    joint = stopping_joint(sampling=Sampling(rate=100.0, delay=30 * ms))
    patient = {"joint": Supervision(stale_after=35 * ms)}
    result = run_stopping(joint=joint, delay=7 * ms, instruments=[Spy()], supervision=patient, observe="latest")
    assert any(stale)
    assert not all(stale)
    assert result.device_counters["joint"]["stale"] == sum(stale)


class Careless(Instrument):
    """Fails on its third observation."""

    observations = 0

    def observed(self, observation: Observation, stimuli: object) -> None:
        self.observations += 1
        if self.observations == 3:
            raise ValueError("no paper left")


def test_an_instrument_that_raises_is_removed_and_the_run_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    careless = Careless()
    with caplog.at_level(logging.ERROR, "rtagent"):
        result = run_stopping(instruments=[careless])
    assert careless.observations == 3
    assert len(result.episodes) == 5
    assert "Careless" in caplog.text
    assert "no paper left" in caplog.text
    assert any("Careless" in fault.message for fault in result.faults)


class Broken(Stopping):
    """A task with a mistake in it."""

    def interpret(self, observation: Observation) -> Outcome:
        outcome = super().interpret(observation)
        if outcome.state[0]:
            raise ZeroDivisionError("the user's mistake")
        return outcome


def test_a_task_that_raises_leaves_the_joint_safe_and_shows_the_line() -> None:
    joint = stopping_joint()
    with pytest.raises(RunError, match="the user's mistake") as caught:
        run_stopping(joint=joint, task=Broken())
    fault = caught.value.result.faults[-1]
    assert 'raise ZeroDivisionError("the user\'s mistake")' in fault.traceback
    assert Path(__file__).name in fault.traceback
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert is_at_rest(joint)


class Forgetful(Sarsa):
    """A learner that fails at its tenth transition."""

    learned = 0

    def update(self, transition: Transition) -> float:
        self.learned += 1
        if self.learned == 10:
            raise RuntimeError("lost my weights")
        return super().update(transition)


def test_a_learner_that_raises_ends_learning_and_not_acting() -> None:
    joint, task = stopping_joint(), Stopping()
    good = sarsa_agent(task)

    def make(rng: object) -> Agent:
        agent = good(rng)  # type: ignore[arg-type]  # handed through
        return Agent(agent.features, Forgetful(size=2, actions=2), agent.policy, agent.rng)

    result = run_stopping(joint=joint, task=task, agent=make, episodes=8)
    assert is_at_rest(joint)
    assert len([episode for episode in result.episodes if episode.finished]) == 8
    assert not result.learned_all
    (fault,) = result.faults
    assert fault.source == "learning"
    assert "lost my weights" in fault.message
    assert 'raise RuntimeError("lost my weights")' in fault.traceback
    assert result.recorder.counters["learned_in_place"] == 9
    assert result.recorder.counters["transitions_not_learned"] == sum(each.steps for each in result.episodes) - 9


def test_cancelling_a_run_makes_the_joint_safe() -> None:
    joint = stopping_joint()
    task = Stopping()

    async def main() -> None:
        schedule = Schedule.preset("reactive", period=10 * ms)
        running = asyncio.ensure_future(run({"joint": joint}, task, sarsa_agent(task), schedule, Plan(episodes=9)))
        await asyncio.sleep(0.2)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running

    clock.run(main(), "virtual")
    assert is_at_rest(joint)


class NotOpening(FakeDevice):
    async def open(self) -> None:
        raise DeviceError("the port is busy")


def test_after_a_suspension_of_the_machine_the_run_is_stopped_safely(monkeypatch: pytest.MonkeyPatch) -> None:
    looks = iter([0, 0, 0])
    monkeypatch.setattr(clock.RealClock, "suspended", lambda self: next(looks, 3600 * second))
    joint = stopping_joint()
    with pytest.raises(RunError, match="the machine was suspended"):
        run_stopping(joint=joint, episodes=50, clock_name="real")
    assert is_at_rest(joint)


def test_what_was_not_learned_before_a_fault_is_learned_after_it() -> None:
    class NeverLearns:
        def cycle(self, situation: object) -> tuple[Component, ...]:
            return (OBSERVE, CHOOSE, ACT)

    task, journal = Stopping(), []

    class Spy(Sarsa):
        def update(self, transition: Transition) -> float:
            journal.append(transition)
            return super().update(transition)

    def make(rng: object) -> Agent:
        agent = sarsa_agent(task)(rng)  # type: ignore[arg-type]  # handed through
        return Agent(agent.features, Spy(size=2, actions=2), agent.policy, agent.rng)

    schedule = {"period": 10 * ms, "chooser": NeverLearns}
    with pytest.raises(RunError) as caught:
        run_stopping(joint=with_faults(disconnect=((300 * ms,),)), task=task, agent=make, **schedule)
    assert len(journal) > 20
    assert caught.value.result.recorder.counters["transitions_not_learned"] == 0


def test_a_device_that_does_not_open_is_a_fault() -> None:
    with pytest.raises(RunError, match="the port is busy"):
        run_stopping(joint=NotOpening(stopping_joint().world))


def test_a_run_that_could_never_advance_is_refused() -> None:
    class Still:
        spec = stopping_joint().spec

        async def open(self) -> None: ...
        async def read(self, newer_than: int) -> Sample:
            raise AssertionError("must not be read")

        async def act(self, command: Command) -> Command:
            return command

        async def make_safe(self) -> None: ...
        async def close(self) -> None: ...

    task = Stopping()

    async def main() -> None:
        await run({"joint": Still()}, task, sarsa_agent(task), Schedule.preset("reactive"))

    with pytest.raises(RunStuckError, match="Give a component a cost"):
        clock.run(main(), "virtual")


def test_one_agent_cannot_serve_several_trials() -> None:
    task = Stopping()
    agent = sarsa_agent(task)(None)  # type: ignore[arg-type]  # its generator is not used

    async def main() -> None:
        await run({"joint": stopping_joint()}, task, agent, Schedule.preset("reactive"), Plan(trials=2))

    with pytest.raises(ScheduleError, match="need a new agent each"):
        clock.run(main(), "virtual")


SIGNALLED = textwrap.dedent(
    """
    import sys
    from rtagent.__main__ import main
    from rtagent_drivers.stopping import StoppingWorld
    safe = StoppingWorld.make_safe
    def told(self, now):
        safe(self, now)
        print("made safe", flush=True)
    StoppingWorld.make_safe = told
    sys.exit(main(sys.argv[1:]))
    """
)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_a_run_safely(number: signal.Signals, tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    command = [sys.executable, "-c", SIGNALLED, "run", str(SCENARIOS / "stopping.toml"), "--json", str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("stopping")
        time.sleep(0.5)
        process.send_signal(number)
        stdout, stderr = process.communicate(timeout=20)
    assert process.returncode == 1
    assert "made safe" in stdout
    assert f"stopped by signal: {number.name}" in stderr
    assert "All devices were made safe" in stderr
    assert '"fatal": true' in out.read_text(), "the results so far are kept"


def test_what_was_seen_of_an_episode_that_was_broken_off_is_kept() -> None:
    with pytest.raises(RunError) as caught:
        run_stopping(joint=with_faults(disconnect=((300 * ms,),)), supervision={"joint": BUDGET}, delay=10 * ms)
    (episode,) = caught.value.result.episodes
    assert not episode.finished
    assert episode.steps > 20
    assert 250 * ms < episode.duration <= 700 * ms
    assert caught.value.result.as_dict()["trials"][0]["episodes"][0]["finished"] is False


class Deaf(FakeDevice):
    """Can be read for ever, but takes no command after the first ten."""

    commands = 0

    async def act(self, command: Command) -> Command:
        self.commands += 1
        if self.commands > 10:
            raise DeviceError("the bus does not take the command")
        return await super().act(command)


@pytest.mark.parametrize("clock_name", ["real", "virtual"])
def test_a_device_that_answers_but_cannot_be_commanded_ends_the_run(clock_name: clock.ClockName) -> None:
    joint = Deaf(stopping_joint().world)
    with pytest.raises(RunError, match="does not take the command") as caught:
        run_stopping(joint=joint, delay=5 * ms, supervision={"joint": BUDGET}, episodes=50, clock_name=clock_name)
    assert caught.value.result.device_counters["joint"]["commands_not_sent"] >= 3
    assert is_at_rest(joint)


class CancelsItself(FakeDevice):
    async def make_safe(self) -> None:
        raise asyncio.CancelledError

    async def close(self) -> None:
        self.closed = True


def test_a_device_whose_stop_is_cancelled_is_told_and_still_closed() -> None:
    joint = CancelsItself(stopping_joint().world)
    result = run_stopping(joint=joint, episodes=1)
    assert result.not_safe == ["device 'joint' could not be made safe: CancelledError()."]
    assert joint.closed
