"""An arm of Dynamixel servos on one bus, as a device."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

from numpy.random import Generator

from rtagent.clock import current
from rtagent.device import Device, LastResort
from rtagent.errors import DeviceError, DisconnectedError, LimitError, SpecError, did_you_mean
from rtagent.experience import Command, Sample
from rtagent.specs import Value
from rtagent.units import Baud, Duration, Frequency, describe, ms, second
from rtagent_drivers.dynamixel import opening
from rtagent_drivers.dynamixel.bus import PATIENCE, Bus
from rtagent_drivers.dynamixel.calibration import read_calibration
from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.faults import ALERT, VOLTAGE, is_grave, sentences
from rtagent_drivers.dynamixel.limits import Reading
from rtagent_drivers.dynamixel.orders import Order, reads_in_groups, switch, sync_writes
from rtagent_drivers.dynamixel.packets import Span, Status
from rtagent_drivers.dynamixel.polling import Roster, Round
from rtagent_drivers.dynamixel.safe_state import secure
from rtagent_drivers.dynamixel.servo import Servo
from rtagent_drivers.dynamixel.settings import Axis, FakeSettings, Joint, Stop, axes, device_spec
from rtagent_drivers.serial_line import find_port, latency_timer, stable_name

SAFE_WITHIN = 1 * second
START_SPEED = 0.5
"""rad/s, at most, on the way to the start pose."""

LATELY = 100 * ms
"""A joint that was read longer ago (and some rounds ago) may be elsewhere by now."""

FIRST_READINGS = 1 * second
"""So long every joint has to be read for the first time."""

SAY_AGAIN = 200 * ms
"""So often the way to the start pose is said again."""

ROUNDS = 3
"""Who hears nothing for so many rounds stood still."""

TRIES = 4
"""So often torque is switched on, and read back."""

ARRIVED, AT_REST = 0.05, 0.1
"""A joint within so much (rad) of its start, and no faster than this (rad/s), has arrived."""


def _in_process(**settings: Any) -> Device:
    """Return a fake of an arm with these settings that is a function of time."""
    from rtagent_drivers.dynamixel.fakes import in_process

    return in_process(**settings)


def _on_wire(**settings: Any) -> Device:
    """Return the driver with these settings on an emulated bus."""
    from rtagent_drivers.dynamixel.fakes import on_wire

    return on_wire(**settings)


class Dynamixel:
    """An arm of Dynamixel servos on one bus (MX, AX, X series), in position, velocity, wheel or torque mode.

    A sample holds what one round of reading brought: for each joint its position (rad), velocity (rad/s), load
    (fraction of the full one), temperature (°C) and voltage (V). `{joint}_fresh` says whether the joint answered in
    this round; if not, its values are its last ones. A joint that has been silent for longer than `silence` is an
    error (0: never). `world_time` is the middle between the request and its last answer, by the host's clock.

    Torque goes on with the first command, or on the way to the start pose; nothing moves before. Making safe means
    to `hold`, to `release`, or to go `home` (to the start pose, within `home_within`) and then to release.
    `bus_watchdog` is the time after which servos that can stop by themselves when they hear nothing (0: never).
    """

    fakes: ClassVar[Mapping[str, Callable[..., Device]]] = {"process": _in_process, "wire": _on_wire}

    def __init__(
        self,
        *,
        port: str,
        joints: Mapping[str, Joint],
        protocol: Literal[1, 2] = 1,
        baud: Baud = 1_000_000,
        rate: Frequency = 50.0,
        calibration: str = "",
        backend: Literal["own", "sdk"] = "own",
        stop: Stop = "release",
        home_within: Duration = 5 * second,
        silence: Duration = 200 * ms,
        bus_watchdog: Duration = 200 * ms,
        return_delay: Duration | None = None,
        fake: FakeSettings = FakeSettings(),  # noqa: B008  # frozen: sharing it changes nothing
    ) -> None:
        if not rate > 0.0:
            raise SpecError(f"rate is {rate}: give how often the servos are read, such as 50Hz.")
        if not 0 <= bus_watchdog <= opening.LONGEST_WATCHDOG:
            longest = describe(opening.LONGEST_WATCHDOG)
            raise SpecError(f"bus_watchdog is {describe(bus_watchdog)}: give up to {longest}, or 0 for none.")
        placings = read_calibration(Path(calibration)) if calibration else {}
        self._axes = axes(joints, protocol, placings)
        _check_starts(self._axes, stop)
        self.spec = device_spec(self._axes, rate)
        self._servos = [Servo(axis, self.spec.actuators[axis.actuator]) for axis in self._axes]
        self._by_actuator = {servo.axis.actuator: servo for servo in self._servos}
        self._port, self._stop, self._silence, self._home_within = port, stop, silence, home_within
        self._return_delay = return_delay
        self._lately = max(LATELY, round(ROUNDS * second / rate))
        able = any("bus_watchdog" in servo.model.registers for servo in self._servos)
        self.tolerates = bus_watchdog if able else 0
        """How long (ns) the servos tolerate to hear nothing (0: for ever)."""
        self._bus = _bus(backend, protocol, port, baud)
        self._path = ""
        self._notes: Sequence[str] = ()
        self._opened = False
        self._sequence = -1
        self._incomplete = self._errors = 0
        self._waiters: list[asyncio.Future[None]] = []
        self._examining: asyncio.Task[None] | None = None
        self._forget()

    def _forget(self) -> None:
        for servo in self._servos:
            servo.forget()
        self._sample: Sample | None = None
        self._values: dict[str, Value] = {}
        self._fault: LimitError | None = None
        self._lost: DisconnectedError | None = None
        self._trouble: DeviceError | None = None
        self._not_before = self._asked_at = 0

    # Life

    async def open(self) -> None:
        """Connect, see who is there, and bring each servo into its mode; nothing moves.

        Raises `DisconnectedError`, or `DeviceError` where a servo does not answer, is
        another one, or is in trouble.
        """
        self._now = current().now
        self._forget()
        self._path = await self._bus.open()
        try:
            await self._set_up()
        except BaseException:
            await self._bus.close()
            raise
        self._opened = True

    async def _set_up(self) -> None:
        bus, servos = self._bus, self._servos
        latency = (latency_timer(self._path) or 0) * ms
        bus.patience = PATIENCE + latency
        tables = await opening.read_tables(bus, servos)
        opening.check_tables(servos, tables)
        for servo in servos:
            servo.on = bool(tables[servo.id].count("torque_enable"))
            await opening.configure(bus, servo, tables[servo.id], self._return_delay)
        bus.return_delay = opening.return_delay(tables) if self._return_delay is None else self._return_delay
        roster = self._roster()
        self._notes = opening.check_rate(bus, roster, self.spec.rate, latency, self._path)
        await opening.set_bus_watchdogs(bus, servos, self.tolerates)
        bus.poll(roster, round(second / self.spec.rate), self._hear, self._lose)
        await self._first_readings()
        await self._hold_what_is_on()

    async def _first_readings(self) -> None:
        ends = self._now() + FIRST_READINGS
        while silent := [servo.axis.name for servo in self._servos if servo.reading is None]:
            if self._now() > ends:
                raise DeviceError(
                    f"{', '.join(silent)} cannot be read: check cables, and the firmware of the servos."
                )
            await self._next_round()
            if self._lost is not None:
                raise self._lost

    async def _hold_what_is_on(self) -> None:
        """Stop what a run of before left moving."""
        on = [servo for servo in self._servos if servo.on]
        if on:
            now = self._now()
            await self._order("hold", {servo.id: servo.stay(now) for servo in on})

    async def close(self) -> None:
        """Let go of the bus. What holds goes on holding."""
        opened, self._opened = self._opened, False
        try:
            if opened and self._lost is None:
                await opening.set_bus_watchdogs(self._bus, self._servos, 0)
        except DeviceError:
            pass  # it has gone meanwhile: there is nothing to let go of
        finally:
            if self._examining is not None:
                self._examining.cancel()
            await self._bus.close()
            self._wake()

    async def make_safe(self) -> None:
        """Hold or release every servo and read that back; with `home`, go there first.

        Raises `DeviceError` that names what is not safe, `DisconnectedError` where the line has gone.
        """
        if self._lost is not None:
            raise self._lost
        if not self._opened:
            return
        if self._stop == "home":
            await self._go_home()
        stop: Stop = "hold" if self._stop == "hold" else "release"
        await secure(self._bus, self._servos, stop, SAFE_WITHIN * 9 // 10, self._now)

    @property
    def safe_within(self) -> int:
        """How long (ns) `make_safe` may take."""
        return SAFE_WITHIN + (self._home_within if self._stop == "home" else 0)

    def last_resort(self) -> LastResort:
        """Return how to make it safe without this process; raise `DisconnectedError` where no port fits."""
        path = self._path or find_port(self._port)
        servos = [[servo.id, servo.axis.name, servo.model.name, servo.axis.joint.mode] for servo in self._servos]
        settings = {
            "port": path,
            "baud": self._bus.baud,
            "protocol": self._bus.codec.protocol,
            "stop": self._stop,
            "servos": servos,
        }
        return LastResort("rtagent_drivers.dynamixel.last_resort:open_spare", settings, stable_name(path))

    @property
    def notes(self) -> Sequence[str]:
        """What makes it slow, as found when it was opened."""
        return self._notes

    @property
    def counters(self) -> Mapping[str, int]:
        """What the bus lost, found damaged and asked again, and rounds in which a joint was silent."""
        return {**self._bus.counters, "rounds_incomplete": self._incomplete, "servo_errors": self._errors}

    # Reading

    async def read(self, newer_than: int) -> Sample:
        """Return the newest sample, or wait for the one above `newer_than`."""
        self._check()
        while self._sample is None or self._sample.sequence <= newer_than:
            await self._next_round()
            self._check()
        return self._sample

    async def _next_round(self) -> None:
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiters.append(waiter)
        await waiter

    def _wake(self) -> None:
        waiters, self._waiters = self._waiters, []
        for waiter in waiters:
            if not waiter.done():
                waiter.set_result(None)

    def _hear(self, round_: Round) -> None:
        """Make a sample of a round; the next one is on its way already."""
        values, answered, self._trouble = dict(self._values), 0, None
        for servo in self._servos:
            status = round_.statuses.get(servo.id)
            fresh = status is not None and len(status.parameters) == servo.span.length
            values[servo.fresh] = fresh
            if status is not None and status.error:
                self._complain(servo, status)
            if status is not None and fresh:
                reading = servo.hear(status.parameters, round_.ended)
                values.update(zip(servo.sensors, reading, strict=True))
                self._hold_against_limits(servo, reading, round_.ended)
                answered += 1
            else:
                servo.miss(round_.ended)
        self._note_stall(round_.sent)
        self._values = values
        self._incomplete += answered < len(self._servos)
        self._trouble = self._trouble or self._silent(round_.ended)
        if answered and len(values) == len(self.spec.sensors) and round_.sent >= self._not_before:
            self._sequence += 1
            middle = (round_.sent + round_.ended) // 2
            self._sample = Sample(values, middle, round_.ended, self._sequence, "arrival")
        self._wake()

    def _note_stall(self, sent: int) -> None:
        """Servos with a Bus Watchdog have stopped if they heard nothing for longer than it allows."""
        before, self._asked_at = self._asked_at, sent
        if before and self.tolerates and sent - before > self.tolerates and self._fault is None:
            self._fault = LimitError(
                f"nothing was sent for {describe(sent - before)}, so that the servos have stopped by themselves: "
                f"find what kept the loop busy, or raise bus_watchdog ({describe(self.tolerates)})."
            )

    def _hold_against_limits(self, servo: Servo, reading: Reading, now: int) -> None:
        said = servo.limits.violated(reading, now, servo.on)
        if said and self._fault is None:
            self._fault = LimitError(said)

    def _silent(self, now: int) -> DeviceError | None:
        """Return an error where a joint has been silent for too long."""
        if not self._silence:
            return None
        late = [
            servo
            for servo in self._servos
            if servo.silent_since is not None and now - servo.silent_since > self._silence
        ]
        if not late:
            return None
        names = ", ".join(f"{servo.axis.name} (id {servo.id})" for servo in late)
        return DeviceError(f"no answer from {names} for {describe(self._silence)}: check its power and cables.")

    def _complain(self, servo: Servo, status: Status) -> None:
        """Take what a servo complains of: what concerns itself is a fault, what concerns a request is counted."""
        protocol = servo.model.protocol
        if status.error != servo.error:
            self._errors += 1
        servo.error = status.error
        if not is_grave(protocol, status.error):
            return
        if protocol == 1:
            self._accuse(servo, status.error, 0)
        elif status.error & ALERT and self._examining is None:
            self._examining = asyncio.get_running_loop().create_task(self._examine(servo, status.error))

    async def _examine(self, servo: Servo, error: int) -> None:
        """Ask a servo of protocol 2.0 what is wrong with it."""
        try:
            found = await opening.read_register(self._bus, servo, "hardware_error")
            self._accuse(servo, error & ALERT, found or 0)
        except DeviceError:
            pass  # the line has gone: that is told already
        finally:
            self._examining = None

    def _accuse(self, servo: Servo, error: int, hardware_error: int) -> None:
        """Note what is wrong with a servo: its voltage may be better next time, all else ends the run."""
        said = sentences(servo.model.protocol, error, hardware_error)
        sentence = " ".join(f"{servo.axis.name} (id {servo.id}) {each}" for each in said)
        if said == [VOLTAGE]:
            self._trouble = self._trouble or DeviceError(sentence)
        elif self._fault is None:
            self._fault = LimitError(sentence)
        self._wake()

    def _lose(self, error: DisconnectedError) -> None:
        self._lost = error
        self._wake()

    def _check(self) -> None:
        """Raise what is wrong."""
        if not self._opened:
            raise DisconnectedError("the arm is closed: open it first.")
        wrong = self._fault or self._lost or self._trouble
        if wrong is not None:
            raise wrong.with_traceback(None)  # it is raised again and again

    # Acting

    async def act(self, command: Command) -> Command:
        """Send a command, a value for each actuator named: an angle (rad), a speed (rad/s) or a fraction of torque.

        Returns what was sent, after limits and in whole counts of the servo. Raises `SpecError` for what is no
        actuator or no number.
        """
        self._check_actable()
        now = self._now()
        told = {self._servo(name): self._servo(name).told(value, now) for name, value in command.items()}
        await self._switch_on(list(told))
        if not await self._order(",".join(command), {servo.id: each.order for servo, each in told.items()}):
            raise DeviceError("a newer command took the place of this one, which was not sent.")
        return {servo.axis.actuator: each.value for servo, each in told.items()}

    def _check_actable(self) -> None:
        if not self._opened:
            raise DisconnectedError("the arm is closed: open it first.")
        wrong = self._fault or self._lost
        if wrong is not None:
            raise wrong.with_traceback(None)  # it is raised again and again

    def _servo(self, actuator: str) -> Servo:
        if actuator not in self._by_actuator:
            raise SpecError(f"there is no actuator {actuator!r}{did_you_mean(actuator, list(self._by_actuator))}")
        return self._by_actuator[actuator]

    async def _switch_on(self, servos: Sequence[Servo]) -> None:
        """Switch torque on where it is off: each servo is to stay where it is, first."""
        off = [servo for servo in servos if not servo.on]
        if not off:
            return
        now = self._now()
        unseen = [servo.axis.name for servo in off if now - servo.read_at > self._lately]
        if unseen:
            raise DeviceError(f"{', '.join(unseen)} was not read lately, so that its torque is not switched on.")
        staying = {servo.id: servo.stay(now) for servo in off}
        on = {servo.id: switch(servo.model, on=True) for servo in off}
        requests = [*sync_writes(self._bus.codec, staying), *sync_writes(self._bus.codec, on)]
        for _ in range(TRIES):
            await self._bus.send("switch on " + ",".join(map(str, staying)), *requests)
            for servo in off:
                servo.on = True  # as far as is known: a stop that comes now has to hold it
            off = [servo for servo in off if not await self._has_torque(servo)]
            if not off:
                return
        for servo in off:
            servo.on = False
        limp = ", ".join(f"{servo.axis.name} (id {servo.id})" for servo in off)
        raise DeviceError(f"torque did not go on: {limp}. Look with `rtagent devices` whether it has shut down.")

    async def _has_torque(self, servo: Servo) -> bool:
        order = switch(servo.model, on=True)
        read = self._bus.codec.read(Span(servo.id, order.address, len(order.data)))
        status = (await self._bus.transact(read, {servo.id: len(order.data)})).get(servo.id)
        return status is not None and status.parameters == order.data

    async def _order(self, key: str, orders: Mapping[int, Order]) -> bool:
        return await self._bus.send(key, *sync_writes(self._bus.codec, orders))

    # Ways

    async def begin_episode(self, rng: Generator) -> None:
        """Go to the start pose, slowly; raise `DeviceError` where a joint does not get there."""
        self._check()
        await self._go({servo: servo.axis.joint.start for servo in self._servos}, 0)
        self._sample = None
        self._not_before = self._now()

    async def _go_home(self) -> None:
        """Go to the start pose as far as that is possible in time: released it will be in any case."""
        try:
            await asyncio.wait_for(
                self._go({servo: servo.axis.joint.start for servo in self._servos if servo.on}, self._home_within),
                self._home_within / second,
            )
        except (DeviceError, TimeoutError):
            return

    async def _go(self, pose: Mapping[Servo, float | None], within: int) -> None:
        """Go to a pose (rad) and wait for arrival, `within` a time (ns; 0: twice what it should take, and 2 s)."""
        goals = {servo: goal for servo, goal in pose.items() if goal is not None}
        if not goals:
            return
        await self._switch_on(list(goals))
        speeds = {servo: min(START_SPEED, servo.axis.max_velocity) for servo in goals}
        farthest = max(abs(_position(servo) - goal) / speeds[servo] for servo, goal in goals.items())
        ends = self._now() + (within or round((2 * farthest + 2) * second))
        orders = {servo.id: servo.go(goal, speeds[servo]) for servo, goal in goals.items()}
        said, stood_still = 0, False
        while away := [servo for servo, goal in goals.items() if not _arrived(servo, goal)]:
            if self._now() > ends:
                names = ", ".join(servo.axis.name for servo in away)
                raise DeviceError(f"{names} did not get to the start pose: see what is in its way, and its load.")
            if self._now() - said > SAY_AGAIN and not stood_still:  # nobody confirms it, and a packet can be lost
                said = self._now()
                await self._order("pose", orders)
            before = self._now()
            await self._next_round()
            stood_still = (
                self._now() - before > ROUNDS * second / self.spec.rate
            )  # it may have been stopped meanwhile
            self._check()

    def _roster(self) -> Roster:
        together = [servo.span for servo in self._servos if reads_in_groups(servo.model)]
        singly = [servo.span for servo in self._servos if not reads_in_groups(servo.model)]
        return Roster(self._bus.codec, together, singly)


def _position(servo: Servo) -> float:
    assert servo.reading is not None, "every joint was read when the arm was opened"
    return servo.reading.position


def _arrived(servo: Servo, goal: float) -> bool:
    assert servo.reading is not None, "every joint was read when the arm was opened"
    return abs(servo.reading.position - goal) <= ARRIVED and abs(servo.reading.velocity) <= AT_REST


def _check_starts(arm: Sequence[Axis], stop: Stop) -> None:
    """Raise `SpecError` where a start pose cannot be gone to."""
    for axis in arm:
        if axis.joint.start is not None and axis.turns_on:
            raise SpecError(f"{axis.name} is in mode {axis.joint.mode!r}, which goes to no place: leave out start.")
    if stop == "home" and all(axis.joint.start is None for axis in arm):
        raise SpecError("stop is home, but no joint has a start: give one, or stop = hold or release.")


def _bus(backend: str, protocol: int, port: str, baud: int) -> Bus:
    if backend == "own":
        return Bus(codec(protocol), port, baud)
    from rtagent_drivers.dynamixel.sdk import sdk_bus

    return sdk_bus(codec(protocol), port, baud)
