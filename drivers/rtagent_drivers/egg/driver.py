"""The world of Experiment 2 (thesis, section 3.4.2): a joint, an egg in its way, and a person with a button."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from numpy.random import Generator

from rtagent.clock import current
from rtagent.errors import SpecError
from rtagent.experience import Command, Stimulus, Values
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import Angle, AngularAcceleration, AngularVelocity, Duration, degree, ms, second
from rtagent_drivers.egg.participant import Participant, Person
from rtagent_drivers.egg.way import Way
from rtagent_drivers.fake import FakeDevice, Faults, Sampling

JOINT = "hammer"
POSITION, VELOCITY = f"{JOINT}_position", f"{JOINT}_velocity"
PRESSED, BROKEN = "pressed", "broken"
SAVED = ("_press", "_error", "_expected", "_seen")
ASSUMED = Participant()


class EggWorld:
    """A joint that is let go at a drawn time of an episode, and then turns from 0 as it is told.

    The egg is at `egg` and breaks when the joint is at `egg` + `give`; the joint goes on, up to `travel` (in rad).
    From the press on `pressed` is true until the episode ends. A modelled person sees where the joint came to rest
    when the next episode begins.
    """

    def __init__(
        self,
        egg: float,
        give: float,
        travel: float,
        velocity: float,
        acceleration: float,
        start: tuple[int, int],
        participant: Participant,
    ) -> None:
        self.egg, self._breaking, self._travel = egg, egg + give, travel
        self._acceleration, self._starts = acceleration, start
        self._person = Person(participant)
        self._live = participant.strategy == "live"
        turning = Spec(unit="rad/s", low=0.0, high=velocity)
        self.spec = DeviceSpec(
            sensors={
                POSITION: Spec(unit="rad", low=0.0, high=travel),
                VELOCITY: turning,
                PRESSED: Spec.flag(),
                BROKEN: Spec.flag(),
            },
            actuators={VELOCITY: turning},
        )
        self._way: Way | None = None
        self._press: int | None = None
        self._seen = 0
        self._expected: list[float] | None = None
        """In how many ns, and at which speed (rad/s), the person expects the joint to meet the egg."""

    def begin(self, now: int, rng: Generator) -> None:
        """Put the joint at its start, and draw when it is let go, and how well the next press is timed."""
        self._remember(now)
        self.let_go = now + int(rng.integers(*self._starts, endpoint=True))
        self._error = self._person.participant.error(rng)
        self._way = Way(now, self._acceleration, self._travel)
        self._press = self._expected = None
        self._seen = now - 1

    def values(self, time: int) -> Values:
        """Return the sensors at `time` (ns)."""
        self._seen = max(self._seen, time)
        position, velocity = self._joint.at(time)
        pressed = self._press is not None and time >= self._press
        return {POSITION: position, VELOCITY: velocity, PRESSED: pressed, BROKEN: position >= self._breaking}

    def command(self, now: int, command: Command) -> Command:
        """Take a speed; before the joint is let go it waits."""
        if VELOCITY in command and float(command[VELOCITY]) != self._joint.speed:
            self._turn(max(now, self.let_go), float(command[VELOCITY]))
        return command

    def press(self, at: int) -> None:
        """Have the button pressed at a time (ns), or just after it was looked at last; the first press counts."""
        at = max(at, self._seen + 1)
        self._press = at if self._press is None else min(at, self._press)

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return the press, if it lies between."""
        if self._press is not None and after < self._press <= until:
            return (Stimulus(self._press, "press"),)
        return ()

    def next_change(self, now: int) -> int | None:
        """Return when the joint is let go, comes to its speed, or breaks the egg, or the button is pressed."""
        return min((time for time in self._changes() if time > now), default=None)

    def make_safe(self, now: int) -> None:
        """Stop the joint."""
        if self._joint.speed:
            self._turn(now, 0.0)

    def save(self) -> Saved:
        """Return the way of the joint, the press, and what the person has learned."""
        fields = save_fields(self, SAVED)
        return {"way": self._joint.save(), "let_go": self.let_go, "lag": self._person.lag} | fields

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, when it has begun."""
        restore_fields(self, SAVED, saved)
        self._joint.restore(saved["way"])
        self.let_go, self._person.lag = saved["let_go"], saved["lag"]

    @property
    def _joint(self) -> Way:
        assert self._way is not None, "a world is begun before it is read"
        return self._way

    def _turn(self, at: int, speed: float) -> None:
        self._joint.turn(at, speed)
        touch = self._joint.reaches(self.egg)
        if speed and touch is not None and self._expected is None and not self._live:
            self._expect(touch, touch - at, speed)

    def _expect(self, touch: int, arrival: int, speed: float) -> None:
        """Let the person see the joint go, know when it will meet the egg, and time the press."""
        self._expected = [arrival, speed]
        aimed = touch - self._person.lead(arrival) + self._error
        self.press(max(touch - arrival + 1, round(aimed)))

    def _remember(self, now: int) -> None:
        """Let the person learn from where the joint stands, if they saw it go."""
        if self._way is None or self._expected is None:
            return
        (arrival, speed), (position, _) = self._expected, self._way.at(now)
        self._person.saw((position - self.egg) / speed * second, arrival)

    def _changes(self) -> Iterator[int]:
        breaks, end = self._joint.reaches(self._breaking), self._joint.reaches(self._travel)
        yield from (self.let_go, self._joint.settles())
        yield from (time for time in (self._press, breaks, end) if time is not None)


class EggDevice(FakeDevice):
    """The world as a device, whose button can be pressed."""

    world: EggWorld

    def press(self, at: int | None = None) -> None:
        """Be pressed now, or at a time (ns) that has just passed."""
        now = current().now()
        self.world.press(now if at is None else min(at, now))


def egg(
    *,
    egg: Angle = 90 * degree,
    give: Angle = 0.0,
    travel: Angle = 120 * degree,
    velocity: AngularVelocity = 200 * degree,
    acceleration: AngularAcceleration = 1000 * degree,
    start: tuple[Duration, Duration] = (500 * ms, 1000 * ms),
    participant: Participant = ASSUMED,
    sampling: Sampling | None = None,
    faults: Faults | None = None,
) -> EggDevice:
    """A fake joint, `hammer`, with an egg in its way, and a modelled person who presses (thesis, Experiment 2)."""
    if not (0 < egg <= egg + give < travel and velocity > 0 and acceleration > 0):
        raise SpecError(
            "the egg is between 0 and the end of the travel, with what it gives; "
            "velocity and acceleration are above 0."
        )
    if not 0 <= start[0] <= start[1]:
        raise SpecError("start is [earliest, latest], both 0 or more and in this order.")
    world = EggWorld(egg, give, travel, velocity, acceleration, start, participant)
    return EggDevice(world, sampling, faults)
