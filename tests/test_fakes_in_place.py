"""`--fake`: fakes in place of hardware, and what is refused."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import pytest
from helpers import virtually
from parts import SCENARIOS, run_stopping

from rtagent import Agent, Limits, Plan, Result, RunError, Sample, Schedule, clock, ms, register, run, second
from rtagent.__main__ import main
from rtagent.device import Device, LastResort
from rtagent.errors import DisconnectedError, LimitError, ScenarioError, SpecError
from rtagent.experience import Command, Observation
from rtagent.features import Binned
from rtagent.instruments import Instrument
from rtagent.learning import TD
from rtagent.scenario import assemble, load
from rtagent.schedule import LEARN, OBSERVE
from rtagent.specs import DeviceSpec, Spec
from rtagent.tasks import Signals
from rtagent.testing import DeviceContract
from rtagent.units import AngularVelocity
from rtagent_drivers.fake import FakeDevice, Sampling
from rtagent_drivers.stopping import stopping_joint


def in_process(*, velocity: AngularVelocity) -> Device:
    return stopping_joint(velocity=velocity)


class Motor:
    """Hardware, as far as anybody can tell without opening it."""

    fakes: ClassVar[dict[str, Callable[..., Device]]] = {"process": in_process}

    def __init__(self, *, velocity: AngularVelocity = 1.0) -> None:
        self.spec = stopping_joint(velocity=velocity).spec

    def last_resort(self) -> LastResort:
        return LastResort("nobody:nothing", {}, "the motor")


class Camera:
    def __init__(self) -> None:
        self.spec = DeviceSpec()


@pytest.fixture
def scenario(tmp_path: Path) -> Callable[..., Path]:
    register("drivers", "motor", Motor)
    register("drivers", "camera", Camera)

    def write(driver: str = "motor") -> Path:
        path = tmp_path / "motor.toml"
        text = (SCENARIOS / "stopping.toml").read_text().replace('driver = "stopping"', f'driver = "{driver}"')
        assert driver in text
        path.write_text(text)
        return path

    return write


def test_fakes_take_the_place_of_hardware_with_its_settings(scenario: Callable[..., Path]) -> None:
    loaded = load(scenario(), ["run.fake=process", "devices.joint={ driver = 'motor', velocity = '90deg/s' }"])
    (device,) = assemble(loaded).devices.values()
    assert device.spec == stopping_joint(velocity=math.pi / 2).spec
    assert loaded.resolved()["run"]["fake"] == "process"


def test_the_command_line_runs_fakes_under_the_virtual_clock(
    scenario: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(scenario())
    joint = "devices.joint={driver='motor',velocity='2rad/s'}"
    options = ["--fake=process", "--set", "run.clock=virtual", "--set", joint]
    assert main(["run", path, "--episodes", "1", "--quiet", *options]) == 0
    assert main(["check", path, *options]) == 0
    assert main(["check", path, *options[1:]]) == 2
    assert "give --fake=process" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("driver", "overrides", "sentence"),
    [
        ("motor", ["run.fake=wire"], "no fake of the level 'wire': give --fake=process."),
        ("camera", ["run.fake=process"], "the driver 'camera' has no fake, so that this would move real hardware"),
        ("motor", ["run.clock=virtual"], "know no virtual clock: give --fake=process"),
    ],
)
def test_what_has_no_fake_is_refused(
    scenario: Callable[..., Path], driver: str, overrides: list[str], sentence: str
) -> None:
    with pytest.raises(ScenarioError, match=sentence):
        assemble(load(scenario(driver), [f"devices.joint={{ driver = '{driver}' }}", *overrides]))


@pytest.mark.parametrize("level", ["wire", "process"])
def test_what_is_a_fake_itself_stays(level: str) -> None:
    for name in ("stopping", "hallway_synchronous"):
        assert assemble(load(SCENARIOS / f"{name}.toml", [f"run.fake={level}"]))


# Events


class Button:
    """Pressed when it is told so; its sample has the time of the last change."""

    spec = DeviceSpec(sensors={"presses": Spec(low=0.0)}, rate=math.inf)

    def __init__(self) -> None:
        self.sample: Sample | None = None
        self.reads: list[int] = []

    async def open(self) -> None:
        now = clock.current().now()
        self.changed, self.sample = asyncio.Event(), Sample({"presses": 0.0}, now, now, 0)

    def press(self) -> None:
        assert self.sample is not None
        now, number = clock.current().now(), self.sample.sequence + 1
        self.sample = Sample({"presses": float(number)}, now, now, number)
        self.changed.set()
        self.changed = asyncio.Event()

    async def read(self, newer_than: int) -> Sample:
        self.reads.append(newer_than)
        if self.sample is None:
            raise DisconnectedError("the button is not open: open it")
        while self.sample.sequence <= newer_than:
            await self.changed.wait()
        return self.sample

    async def act(self, command: Command) -> Command:
        if command:
            raise SpecError("a button takes no commands")
        return {}

    async def make_safe(self) -> None:
        pass

    async def close(self) -> None:
        self.sample = None


class TestButton(DeviceContract):
    clock = "virtual"

    def make_device(self) -> Device:
        return Button()


async def observed_presses(button: Button, presses: list[int], **others: Device) -> tuple[list[int], Result]:
    """Return when (ms since the beginning) each number of presses was first observed."""
    seen: dict[float, int] = {}

    class Spy(Instrument):
        def observed(self, observation: Observation, stimuli: object) -> None:
            seen.setdefault(float(observation.samples["button"].values["presses"]), observation.time - began)

    began, loop = clock.current().now(), asyncio.get_running_loop()
    for press in presses:
        loop.call_later(press / 1e3, button.press)
    task = Signals(signals=("button.presses",))
    task.bind({"button": button.spec})
    agent = Agent(Binned(state={"presses": Spec(low=0.0, high=9.0)}, bins=2), TD(size=2))
    plan = Plan(limits=Limits(episode_time=800 * ms))
    schedule = Schedule((OBSERVE, LEARN), observe_timeout=50 * ms)
    result = await run({"button": button, **others}, task, agent, schedule, plan, instruments=[Spy()])
    return [time // ms for time in seen.values()], result


def test_an_agent_sleeps_until_something_happens() -> None:
    button = Button()
    times, result = virtually(observed_presses(button, [120, 333, 700]))
    assert times == [0, 120, 333, 700]
    assert result.recorder.counters["observe_timeouts"] >= 12, "between the presses it looks every 50 ms"
    assert result.device_counters["button"] == {}, "what does not happen is no fault"


def test_events_come_at_once_beside_a_sampled_device() -> None:
    joint = stopping_joint(sampling=Sampling(rate=40.0))
    times, result = virtually(observed_presses(Button(), [120, 333, 700], joint=joint))
    assert times == [0, 120, 333, 700]
    assert result.device_counters["button"] == {}
    assert not result.recorder.counters["observe_timeouts"]


# Limits


def test_a_limit_ends_a_run_at_once_and_nothing_is_tried_again() -> None:
    joint = stopping_joint()
    acts: list[int] = []

    async def act(command: Command) -> Command:
        acts.append(1)
        raise LimitError("the joint is at its end: move it back by hand")

    joint.act = act  # type: ignore[method-assign]
    with pytest.raises(RunError, match="move it back by hand") as caught:
        run_stopping(joint=joint)
    assert len(acts) == 1
    assert caught.value.result.not_safe == []


# Safe within


def test_a_device_that_goes_home_is_given_the_time_that_it_needs() -> None:
    class Homing(FakeDevice):
        safe_within = 5 * second

        async def make_safe(self) -> None:
            await asyncio.sleep(self.needs)

    for needs, not_safe in (
        (4.0, []),
        (6.0, ["device 'joint' could not be made safe within 5 s: it does not answer."]),
    ):
        joint = Homing(stopping_joint().world)
        joint.needs = needs
        assert run_stopping(joint=joint, episodes=1).not_safe == not_safe
