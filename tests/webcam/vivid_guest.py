"""What vivid.sh runs in the guest: the webcam driver on /dev/video0; every line says what was seen.

Exits with 1 where something was not as it must be.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import sys
from fcntl import ioctl
from pathlib import Path
from statistics import median

from rtagent import Agent, Limits, Plan, Schedule, clock, run
from rtagent.errors import DisconnectedError
from rtagent.experience import Observation, Sample
from rtagent.features import Binned
from rtagent.instruments import Instrument
from rtagent.learning import TD
from rtagent.schedule import LEARN, OBSERVE, Wait
from rtagent.supervision import Supervision
from rtagent.tasks import Signals
from rtagent.units import ms
from rtagent_drivers.webcam import Webcam
from rtagent_drivers.webcam.v4l2 import QUERYCTRL, S_CTRL, Control, ControlQuery

CAMERA = "/dev/video0"
NEXT = 0x80000000
failed: list[str] = []


def tell(line: str) -> None:
    sys.stdout.write(line + "\n")


def say(sentence: str, right: bool = True) -> None:
    tell(("ok    " if right else "WRONG ") + sentence)
    if not right:
        failed.append(sentence)


def controls() -> dict[str, int]:
    """Return the camera's controls: their numbers by their names."""
    file, found, query = os.open(CAMERA, os.O_RDWR), {}, ControlQuery(id=NEXT)
    try:
        while True:
            ioctl(file, QUERYCTRL, query)
            found[query.name.decode()] = query.id
            query = ControlQuery(id=query.id | NEXT)
    except OSError:
        return found
    finally:
        os.close(file)


def turn(control: int, value: int) -> None:
    """Set a control."""
    file = os.open(CAMERA, os.O_RDWR)
    try:
        ioctl(file, S_CTRL, Control(control, value))
    finally:
        os.close(file)


async def frames(camera: Webcam, count: int) -> list[Sample]:
    samples = [await camera.read(-1)]
    while len(samples) < count:
        samples.append(await camera.read(samples[-1].sequence))
    return samples


def steady(samples: list[Sample], rate: float) -> str:
    times = [sample.world_time for sample in samples]
    steps = [after - before for before, after in itertools.pairwise(times)]
    ages = [sample.arrival_time - sample.world_time for sample in samples]
    values = {name: round(float(value), 3) for name, value in samples[-1].values.items()}
    say(
        f"{len(samples)} frames, {median(steps) / ms:.1f} ms apart in the median by the "
        f"{samples[-1].time_source}'s clock, {median(ages) / ms:.2f} ms old at arrival "
        f"(at most {max(ages) / ms:.2f}); {values}",
        abs(median(steps) * rate / 1e9 - 1) < 0.1 and min(ages) >= 0,
    )
    return str(values)


async def stream(**settings: object) -> None:
    camera = Webcam(device=CAMERA, **settings)  # type: ignore[arg-type]  # settings of all kinds
    tell(f"-- {settings or 'as it is'}, loop {type(asyncio.get_running_loop()).__name__}")
    await camera.open()
    try:
        steady(await frames(camera, 45), camera.spec.rate)
        say(f"counters {dict(camera.counters)}")
    finally:
        await camera.close()


async def gaps(dropped: int) -> None:
    tell("-- the camera drops a part of its frames")
    camera = Webcam(device=CAMERA)
    await camera.open()
    before = await frames(camera, 5)
    turn(dropped, 30)
    samples = await frames(camera, 60)
    turn(dropped, 0)
    steps = [after.sequence - before.sequence for before, after in itertools.pairwise(samples)]
    lost = camera.counters.get("frames_lost", 0)
    spans = samples[-1].world_time - samples[0].world_time
    say(
        f"30 % of buffers dropped: {lost} frames counted as lost, {sum(step > 1 for step in steps)} gaps in the "
        f"numbers; {sum(steps)} numbers in {spans / 1e9:.2f} s",
        lost > 0 and abs(sum(steps) * 1e9 / spans / camera.spec.rate - 1) < 0.1 and before[0].sequence >= 0,
    )
    await camera.close()


async def blocked() -> None:
    tell("-- the loop is blocked for a second")
    camera = Webcam(device=CAMERA)
    await camera.open()
    await frames(camera, 10)
    await clock.current().compute(1000 * ms)
    found = await camera.read(-1)
    age = clock.current().now() - found.world_time
    following = await camera.read(found.sequence)
    fresh = clock.current().now() - following.world_time
    say(
        f"the newest frame in the kernel's buffers is {age / ms:.0f} ms old and says so; the next "
        f"{fresh / ms:.1f} ms; {dict(camera.counters)}",
        fresh < age,
    )
    await camera.close()


async def unplug(disconnect: int, **settings: object) -> None:
    tell(f"-- unplugged and plugged in again {settings or ''}".rstrip())
    camera = Webcam(device=CAMERA, **settings)  # type: ignore[arg-type]  # settings of all kinds
    await camera.open()
    last = (await frames(camera, 10))[-1]
    reading = asyncio.ensure_future(camera.read(last.sequence + 1000))
    await asyncio.sleep(0.05)
    pulled = clock.current().now()
    turn(disconnect, 1)
    try:
        await asyncio.wait_for(reading, 5)
        say("the read went on", right=False)
    except DisconnectedError as error:
        say(f"{(clock.current().now() - pulled) / ms:.1f} ms after it was unplugged: {error}")
    await camera.close()  # vivid's camera comes back once nobody has it open
    began = clock.current().now()
    await camera.open()
    sample = await camera.read(-1)
    say(
        f"back: its first frame, number {sample.sequence} after {last.sequence}, "
        f"{(sample.arrival_time - began) / ms:.0f} ms after opening began",
        sample.sequence > last.sequence and sample.world_time > last.world_time,
    )
    steady(await frames(camera, 15), camera.spec.rate)
    await camera.close()


class Cycles(Instrument):
    """When cycles observed, how old the frame was by its own time, and whether it was marked."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, int, bool]] = []

    def observed(self, observation: Observation, stimuli: object) -> None:
        self.seen.append((observation.time, observation.age("camera"), "camera" in observation.stale))


async def supervised(disconnect: int) -> None:
    tell("-- unplugged in a run that observes 50 times a second, and plugged in again")
    camera, cycles = Webcam(device=CAMERA), Cycles()
    task = Signals(signals=("camera.red", "camera.green"))
    task.bind({"camera": camera.spec})
    agent = Agent(Binned(state=task.state, bins=4), TD(size=16))
    schedule = Schedule((OBSERVE, LEARN), period=20 * ms, observe=Wait.LATEST)
    patience = {"camera": Supervision(timeout=10_000 * ms, stale_after=150 * ms)}
    asyncio.get_running_loop().call_later(2.0, turn, disconnect, 1)
    plan = Plan(limits=Limits(episode_time=4_000 * ms))
    result = await run({"camera": camera}, task, agent, schedule, plan, supervision=patience, instruments=[cycles])
    counts, seen = result.device_counters["camera"], cycles.seen
    periods = [after[0] - before[0] for before, after in itertools.pairwise(seen)]
    say(
        f"{len(seen)} observations, {median(periods) / ms:.1f} ms apart in the median; the oldest frame was "
        f"{max(age for _, age, _ in seen) / ms:.0f} ms old, {sum(marked for *_, marked in seen)} were marked as "
        f"stale, the last was {seen[-1][1] / ms:.0f} ms old",
        all(marked == (age > 150 * ms) for _, age, marked in seen) and seen[-1][1] < 150 * ms,
    )
    say(f"counted: {counts}", counts.get("reopened", 0) >= 1 and not result.faults[-1].fatal)


async def absent() -> None:
    tell("-- what is not there")
    for settings in (
        {"device": "/dev/video7"},
        {"device": "/dev/null"},
        {"device": CAMERA, "width": 700},
        {"device": CAMERA, "rate": 17.0},
    ):
        try:
            await Webcam(**settings).open()  # type: ignore[arg-type]  # settings of all kinds
            say(f"{settings} was opened", right=False)
        except DisconnectedError as error:
            say(str(error))
    first, second_ = Webcam(device=CAMERA), Webcam(device=CAMERA)
    await first.open()
    try:
        await second_.open()
        say("two had it at once", right=False)
    except DisconnectedError as error:
        say(str(error))
    await first.close()


def main() -> int:
    found = controls()
    tell(
        f"Linux {os.uname().release}, {len(found)} controls of {CAMERA}, {len(os.sched_getaffinity(0))} processors"
    )
    clock.run(stream())
    tell("-- from here on it stamps frames when their exposure begins, not when they will have been transferred")
    turn(found["Timestamp Source"], 1)
    clock.run(stream(rate=25.0))
    from rtagent.clock.uv import uvloop_loop

    clock.run(stream(), make_loop=uvloop_loop)
    dropped = next(number for name, number in found.items() if "Dropped" in name)
    clock.run(gaps(dropped))
    clock.run(blocked())
    clock.run(absent())
    clock.run(unplug(found["Disconnect"]))
    clock.run(unplug(found["Disconnect"]), make_loop=uvloop_loop)
    clock.run(supervised(found["Disconnect"]))
    clock.run(stream(backend="opencv", rate=25.0))
    clock.run(unplug(found["Disconnect"], backend="opencv", rate=25.0))
    left = [link for link in Path("/proc/self/fd").iterdir() if "video" in os.path.realpath(link)]
    say(f"files of the camera still open: {len(left)}", not left)
    tell(f"{len(failed)} wrong")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
