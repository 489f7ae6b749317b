"""An Arduino board as a device: its channels are sensors, its servos actuators."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from math import isfinite

from numpy.random import Generator

from rtagent.clock import current
from rtagent.device import LastResort
from rtagent.errors import DeviceError, DisconnectedError, SpecError, did_you_mean
from rtagent.experience import Command, Sample
from rtagent.specs import Value
from rtagent.units import describe, ms, second
from rtagent_drivers.arduino import frames, opening
from rtagent_drivers.arduino.link import Link
from rtagent_drivers.arduino.messages import Hello, Message, Safety, Scan, ServoState
from rtagent_drivers.arduino.sampling import Sampler
from rtagent_drivers.arduino.settings import Settings, actuator
from rtagent_drivers.arduino.speaking import Speaker
from rtagent_drivers.serial_line import find_port, stable_name

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
        self._speaker: Speaker | None = None
        self._configure_again_at = 0
        self._sample: Sample | None = None
        self._trouble: DeviceError | None = None
        self._state: ServoState | None = None
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
        self._sample, self._trouble, self._configure_again_at = None, None, 0
        pins = self.settings.layout.channels if hello is None else hello.channels
        order = self.settings.layout.servos if hello is None else hello.servos
        self._sampler = Sampler(self.settings, pins, opening.latency(self.settings, hello))
        self._sampler.sequence = self._sequence
        self._speaker = Speaker(self.settings, order, link, self._now)
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
        if self._speaker is not None:
            self._speaker.forget()
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
        link, speaker = self._link, self._speaker
        if link is None or speaker is None or not self.settings.servos:
            return
        speaker.stop()
        if self.settings.layout.legacy:
            link.write(speaker.here)
            return
        for _ in range(ATTEMPTS):
            self._state = None
            link.write(frames.MAKE_SAFE)
            if await self._confirmed():
                return
        raise DeviceError("the board did not confirm that its servos are safe: switch their power off.")

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
                if message.started:
                    scans.clear()  # they are of before its reset
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
        elif self._configure_again_at and now >= self._configure_again_at:
            self._configure()
        self._sample = self._sampler.take(fitting, now)

    def _hear_hello(self, hello: Hello) -> None:
        if not hello.started:
            if opening.is_configured(hello, self.settings):
                self._configure_again_at = 0
            return
        self._note_reset()
        try:
            opening.check_board(self.settings, hello)
        except DeviceError as error:  # another sketch was uploaded meanwhile
            self._trouble = error

    def _note_reset(self) -> None:
        """Begin anew with a board that has begun anew."""
        assert self._sampler is not None, "it listens only while it is open"
        assert self._speaker is not None, "and speaks"
        self._resets += 1
        self._sampler.restart()
        self._speaker.forget()
        self._configure()
        self._trouble = DeviceError(
            "the board was reset, and its servos have gone limp: see to its power and its cable; it goes on."
            if self.settings.servos
            else "the board was reset: see to its power and its cable; it goes on."
        )

    def _configure(self) -> None:
        """Tell a board that has begun anew its settings; it answers, or is told again."""
        self._configure_again_at = self._now() + opening.ANSWERING
        try:
            if self._link is not None:
                self._link.write(opening.configuration(self.settings))
        except DisconnectedError:
            self._wake()

    def _hear_state(self, state: ServoState) -> None:
        self._state, speaker = state, self._speaker
        if speaker is None or not speaker.armed or state.safety == Safety.MOVING:
            return
        self._missed += state.safety == Safety.UNHEARD
        speaker.stop()
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
        if self._link is None or self._speaker is None:
            raise DisconnectedError("the board is closed: open it first.")
        goals = {self._servo(name): _number(name, value) for name, value in command.items()}
        return {actuator(name): goal for name, goal in self._speaker.go(goals).items()}

    def _servo(self, name: str) -> str:
        if name not in self._by_actuator:
            raise SpecError(f"there is no actuator {name!r}{did_you_mean(name, list(self._by_actuator))}")
        return self._by_actuator[name]


class ArduinoWithServos(Arduino):
    """A board that moves something: guarded from outside, and by its own heartbeat."""

    safe_within = SAFE_WITHIN

    async def begin_episode(self, rng: Generator) -> None:
        """Send the servos that have a start there, and wait until they should have arrived."""
        self._check()
        assert self._speaker is not None, "it is open"
        began = self._now()
        await current().sleep_until(self._speaker.start())
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
