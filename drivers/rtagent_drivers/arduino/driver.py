"""An Arduino board as a device: its channels are sensors, its servos actuators."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import Any, Literal

from numpy.random import Generator

from rtagent.clock import current
from rtagent.device import Device, LastResort
from rtagent.errors import DeviceError, DisconnectedError, SpecError, did_you_mean
from rtagent.experience import Command, Sample
from rtagent.specs import Value
from rtagent.units import Baud, Duration, Frequency, describe, ms, second
from rtagent_drivers.arduino import frames, opening
from rtagent_drivers.arduino.layouts import Format
from rtagent_drivers.arduino.link import Link
from rtagent_drivers.arduino.messages import Hello, Message, Safety, Scan, ServoState
from rtagent_drivers.arduino.sampling import Sampler
from rtagent_drivers.arduino.servos import ServoBank
from rtagent_drivers.arduino.settings import Channel, FakeSettings, Servo, Settings, Stop, actuator
from rtagent_drivers.serial_line import find_port, stable_name

SERVO_FRAME = 20 * ms
"""Servos take a new pulse so often: on its way a servo is told as often where to be."""

BEATS = 4
"""The board is spoken to so often within its heartbeat."""

SAFE_WITHIN = 3 * second
"""From outside, opening the port may reset the board: it answers when it has started again."""

ATTEMPT, ATTEMPTS = 100 * ms, 9
FIRST_SCAN = 1 * second


class Arduino:
    """A board that measures; in our format a sample's `world_time` is the board's, fitted to the host's clock."""

    def __init__(self, settings: Settings) -> None:
        self.settings, self.spec = settings, settings.spec()
        self._by_actuator = {actuator(name): name for name in settings.servos}
        self._path = ""
        self._link: Link | None = None
        self._sampler: Sampler | None = None
        self._servos = ServoBank(settings.servos, settings.layout.servos, legacy=settings.layout.legacy)
        self._hello: Hello | None = None
        self._sample: Sample | None = None
        self._trouble: DeviceError | None = None
        self._armed = False
        self._state: ServoState | None = None
        self._beating: asyncio.TimerHandle | None = None
        self._waiters: list[asyncio.Future[None]] = []
        self._past_bad = self._past_lost = self._resets = self._missed = self._misfits = 0
        self._sequence = -1

    # Life

    async def open(self) -> None:
        """Connect, wait until the board is there, and tell it its settings; nothing moves.

        Raises `DisconnectedError`, or `DeviceError` with a sentence on what is wrong with the board.
        """
        self._loop, self._now = asyncio.get_running_loop(), current().now
        self._link = link = Link(self.settings.layout.decoder())
        try:
            self._path = await link.open(self.settings.port, self.settings.bits)
            hello = await opening.meet(link, self.settings, self._now)
            if hello is not None:
                hello = await opening.configure(link, self.settings, hello, self._now)
            self._begin(link, hello)
            await self._first_sample()
        except BaseException:
            await self.close()
            raise

    def _begin(self, link: Link, hello: Hello | None) -> None:
        self._hello, self._sample, self._trouble = hello, None, None
        pins = self.settings.layout.channels if hello is None else hello.channels
        order = self.settings.layout.servos if hello is None else hello.servos
        self._sampler = Sampler(self.settings, pins, opening.latency(self.settings, hello))
        self._sampler.sequence = self._sequence
        self._servos = ServoBank(self.settings.servos, order, legacy=hello is None)
        link.hear, link.when_lost = self._hear, self._wake

    async def _first_sample(self) -> None:
        ends = self._now() + FIRST_SCAN + 2 * self.settings.period
        try:
            async with asyncio.timeout((ends - self._now()) / second):
                await self.read(-1)
        except TimeoutError:
            raise DeviceError(
                f"the board at {self.settings.port} sends no scans of its channels: reset it."
            ) from None

    async def close(self) -> None:
        """Let go of the port. The board makes its servos safe when it has heard nothing for a while."""
        link, self._link = self._link, None
        self._stop_beating()
        if self._sampler is not None and link is not None:
            self._sequence = self._sampler.sequence
            self._past_lost += self._sampler.lost
            self._past_bad += link.bad
            self._sampler = None
        self._wake()
        if link is not None:
            await link.close()

    async def make_safe(self) -> None:
        """Have the board let go of its servos, or hold them, and confirm that.

        Raises `DeviceError` where it does not, `DisconnectedError` where the line has gone.
        """
        link = self._link
        if link is None or not self.settings.servos:
            return
        self._stop_beating()
        self._stay()
        if self.settings.layout.legacy:
            link.write(self._servos.said(self._now()))
            return
        for _ in range(ATTEMPTS):
            self._state = None
            link.write(frames.MAKE_SAFE)
            if await self._confirmed():
                return
        raise DeviceError("the board did not confirm that its servos are safe: switch their power off.")

    def _stay(self) -> None:
        self._armed = False
        if self.settings.stop == "hold":
            self._servos.stay(self._now())
        else:
            self._servos.forget()

    async def _confirmed(self) -> bool:
        """Wait for the board to say that its servos are safe; return whether it did."""
        ends = self._now() + ATTEMPT
        while self._now() < ends:
            if self._link is None or self._link.lost is not None:
                raise DisconnectedError("the board has gone while it was made safe.")
            if self._state is not None:
                return self._is_safe(self._state)
            try:
                async with asyncio.timeout((ends - self._now()) / second):
                    await self._next_message()
            except TimeoutError:
                return False
        return False

    def _is_safe(self, state: ServoState) -> bool:
        return state.safety != Safety.MOVING and (self.settings.stop == "hold" or not any(state.pulses))

    @property
    def counters(self) -> Mapping[str, int]:
        """What was lost or damaged on the line, and how often the board was reset or missed its heartbeat."""
        lost = self._past_lost + (self._sampler.lost if self._sampler else 0)
        bad = self._past_bad + (self._link.bad if self._link else 0)
        return {
            "scans_lost": lost,
            "frames_bad": bad,
            "scans_misfit": self._misfits,
            "board_resets": self._resets,
            "heartbeats_missed": self._missed,
        }

    # Reading

    async def read(self, newer_than: int) -> Sample:
        """Return the newest sample, or wait for one above `newer_than`."""
        self._check()
        while self._sample is None or self._sample.sequence <= newer_than:
            await self._next_message()
            self._check()
        return self._sample

    def _check(self) -> None:
        """Raise what is wrong; what may be better next time is told once."""
        if self._link is None:
            raise DisconnectedError("the board is closed: open it first.")
        if self._link.lost is not None:
            raise self._link.lost
        trouble, self._trouble = self._trouble, None
        if trouble is not None:
            raise trouble

    async def _next_message(self) -> None:
        waiter: asyncio.Future[None] = self._loop.create_future()
        self._waiters.append(waiter)
        await waiter

    def _wake(self) -> None:
        waiters, self._waiters = self._waiters, []
        for waiter in waiters:
            if not waiter.done():
                waiter.set_result(None)

    def _hear(self, messages: Sequence[Message]) -> None:
        """Take what came together: of scans only the newest becomes a sample."""
        now, scans = self._now(), []
        for message in messages:
            if isinstance(message, Scan):
                scans.append(message)
            elif isinstance(message, Hello):
                scans.clear()
                self._hear_hello(message)
            else:
                self._hear_state(message)
        if scans:
            self._hear_scans(scans, now)
        self._wake()

    def _hear_scans(self, scans: Sequence[Scan], now: int) -> None:
        assert self._sampler is not None, "it listens only while it is open"
        fitting = [scan for scan in scans if self._sampler.fits(scan)]
        self._misfits += len(scans) - len(fitting)
        if not fitting:
            return
        if self._sampler.stood_still(fitting[-1], now):
            self._note_reset()
        self._sample = self._sampler.take(fitting, now)

    def _hear_hello(self, hello: Hello) -> None:
        if not hello.started:
            return
        self._note_reset()
        try:
            opening.check_board(self.settings, hello)
        except DeviceError as error:  # another sketch was uploaded meanwhile
            self._trouble = error

    def _note_reset(self) -> None:
        """Begin anew with a board that has begun anew."""
        assert self._sampler is not None, "it listens only while it is open"
        self._resets += 1
        self._sampler.restart()
        self._stop_beating()
        self._servos.forget()
        self._armed = False
        self._say(opening.configuration(self.settings))
        self._trouble = DeviceError(
            "the board was reset, and its servos have gone limp: see to its power and its cable; it goes on."
            if self.settings.servos
            else "the board was reset: see to its power and its cable; it goes on."
        )

    def _hear_state(self, state: ServoState) -> None:
        self._state = state
        if not self._armed or state.safety == Safety.MOVING:
            return
        self._missed += state.safety == Safety.UNHEARD
        self._stop_beating()
        self._stay()
        why = (
            f"it heard nothing for {describe(self.settings.heartbeat)}, as the event loop was kept from it"
            if state.safety == Safety.UNHEARD
            else "somebody told it to"
        )
        self._trouble = DeviceError(
            f"the board has made its servos safe: {why}. The next command moves them again."
        )

    # Acting

    async def act(self, command: Command) -> Command:
        """Send servos on their way (rad); return where they go, within their limits.

        Raises `SpecError` for what is no actuator or no number.
        """
        if self._link is None:
            raise DisconnectedError("the board is closed: open it first.")
        goals = {self._servo(name): _number(name, value) for name, value in command.items()}
        now = self._now()
        sent = {actuator(name): self._servos.go(name, goal, now) for name, goal in goals.items()}
        if sent:
            self._move(now)
        return sent

    def _servo(self, name: str) -> str:
        if name not in self._by_actuator:
            raise SpecError(f"there is no actuator {name!r}{did_you_mean(name, list(self._by_actuator))}")
        return self._by_actuator[name]

    def _move(self, now: int) -> None:
        """Tell the board where its servos are to be by now, and go on telling it."""
        assert self._link is not None, "it was asked before"
        arming = b"" if self._armed or self._servos.legacy else frames.ARM
        self._link.write(arming + self._servos.said(now))
        self._armed = True
        self._stop_beating()
        wait = SERVO_FRAME if self._servos.moving(now) else self.settings.heartbeat // BEATS
        self._beating = self._loop.call_later(wait / second, self._beat)

    def _beat(self) -> None:
        """Say again where the servos are to be: that is the heartbeat, and makes good what was lost."""
        self._beating = None
        try:
            self._move(self._now())
        except DisconnectedError:
            self._wake()

    def _stop_beating(self) -> None:
        if self._beating is not None:
            self._beating.cancel()
            self._beating = None

    def _say(self, data: bytes) -> None:
        try:
            if self._link is not None:
                self._link.write(data)
        except DisconnectedError:
            self._wake()


class ArduinoWithServos(Arduino):
    """A board that moves something: guarded from outside, and by its own heartbeat."""

    safe_within = SAFE_WITHIN

    async def begin_episode(self, rng: Generator) -> None:
        """Send the servos that have a start there, and wait until they should have arrived."""
        self._check()
        began = self._now()
        arrival = self._servos.start(began)
        if self._servos.on:
            self._move(began)
        await current().sleep_until(arrival)
        self._sample = None
        while self._sample is None or self._sample.world_time < began:
            await self._next_message()
            self._check()

    @property
    def tolerates(self) -> int:
        """How long (ns) the board tolerates to hear nothing (0: for ever)."""
        return 0 if self.settings.layout.legacy else self.settings.heartbeat

    def last_resort(self) -> LastResort:
        """Return how to make it safe without this process; raise `DisconnectedError` where no port is found."""
        path = self._path or find_port(self.settings.port)
        settings = {
            "port": path,
            "baud": self.settings.bits,
            "legacy": self.settings.layout.legacy,
            "stop": self.settings.stop,
        }
        return LastResort("rtagent_drivers.arduino.last_resort:open_spare", settings, stable_name(path))


def _number(name: str, value: Value) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not isfinite(value):
        raise SpecError(f"{name} is {value!r}: give an angle in rad.")
    return float(value)


def arduino(
    *,
    port: str,
    format: Format = "rtagent",  # noqa: A002  # what scenarios call it
    baud: Baud | Literal["usb"] | None = None,
    channels: Mapping[str, Channel] | None = None,
    servos: Mapping[str, Servo] | None = None,
    rate: Frequency | None = None,
    heartbeat: Duration = 200 * ms,
    stop: Stop = "detach",
    fake: FakeSettings = FakeSettings(),  # noqa: B008  # frozen: sharing it changes nothing
) -> Arduino:
    """An Arduino board, at `port`, that speaks our `format` or one of older sketches: its channels are sensors.

    `channels` and `servos` are pins by the names that they have in a scenario; all channels are measured `rate`
    times a second. `baud` is "usb" for a board with native USB, such as the Leonardo. A board with servos makes
    them safe by its own when it has heard nothing for `heartbeat`, and when it is told to: it gives no more pulses
    (`stop` = "detach"), or goes on with those of the moment ("hold"). A servo is commanded by its angle (rad).
    """
    given = {"port": port, "format": format, "baud": baud, "channels": channels, "servos": servos, "rate": rate}
    settings = Settings.of(**given, heartbeat=heartbeat, stop=stop, fake=fake)
    return ArduinoWithServos(settings) if settings.servos else Arduino(settings)


def _in_process(**settings: Any) -> Device:
    """Return a fake of a board with these settings that is a function of time."""
    from rtagent_drivers.arduino.fakes import in_process

    return in_process(**settings)


def _on_wire(**settings: Any) -> Device:
    """Return the driver with these settings on an emulated board."""
    from rtagent_drivers.arduino.fakes import on_wire

    return on_wire(**settings)


FAKES: Mapping[str, Callable[..., Device]] = {"process": _in_process, "wire": _on_wire}
arduino.fakes = FAKES  # type: ignore[attr-defined]  # what moves something is of another class: no class has them all
