"""A telephone switchboard: calls come in on lines, seldom in calm phases and often in busy ones.

Each line is to be put through to one outlet, which the operator is not told; from time to time the board is wired
anew. A lamp may announce the busy phases.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from numpy.random import Generator

from rtagent.errors import SpecError
from rtagent.experience import Command, Stimulus, Values
from rtagent.saving import Saved
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import Duration, ms, second
from rtagent_drivers.fake import FakeDevice, Faults, Sampling

Range = tuple[Duration, Duration]
TRAFFIC = second
"""The traffic is the number of calls that came in within this time."""


class Call(NamedTuple):
    """A call: when it comes in and rings off (ns), on which line (from 1), and the outlet (from 0) it is for."""

    begins: int
    ends: int
    line: int
    outlet: int

    @property
    def kind(self) -> str:
        """What its stimulus is called."""
        return f"call for outlet {self.outlet}"


@dataclass(frozen=True)
class Traffic:
    """How calls come: lengths of phases, and gaps between calls in them, each drawn uniformly; times in ns.

    The lamp is on from `lead` before a busy phase (0: never) to its end. The board is wired anew at the beginning
    of every so many busy phases (`rewired`; 0: never).
    """

    calm: Range
    busy: Range
    calm_gap: Range
    busy_gap: Range
    patience: int
    lead: int
    rewired: int


class SwitchboardWorld:
    """A board with so many `lines` and `outlets`; one call rings at a time.

    `reward` is the sum since the episode began: a call that is put through to its outlet earns what is left of its
    patience, from 1 to 0, one put through to another, or not at all, nothing.
    """

    def __init__(self, lines: int, outlets: int, traffic: Traffic) -> None:
        self._lines, self._outlets, self._traffic = lines, outlets, traffic
        most = TRAFFIC // min(traffic.calm_gap[0], traffic.busy_gap[0]) + 2
        self.spec = DeviceSpec(
            sensors={
                "line": Spec.discrete(lines + 1),
                "lamp": Spec.flag(),
                "busy": Spec.flag(),
                "traffic": Spec(low=0.0, high=float(most)),
                "reward": Spec(low=0.0),
            },
            actuators={"line": Spec.discrete(lines + 1), "outlet": Spec.discrete(outlets)},
        )

    def begin(self, now: int, rng: Generator) -> None:
        """Begin a calm phase."""
        self._rng = rng
        self._calls: list[Call] = []
        self._begins: list[int] = []
        self._phases: list[tuple[int, int]] = []
        self._drawn_until = now
        self._answered: dict[int, tuple[int, float]] = {}
        self._earned: list[tuple[int, float]] = []
        self._rewire()

    def values(self, time: int) -> Values:
        """Return the sensors at `time` (ns)."""
        self._draw_until(time)
        call = self._ringing(time)
        start, end = self._phase(time)
        return {
            "line": 0 if call is None else call.line,
            "lamp": bool(self._traffic.lead) and start - self._traffic.lead <= time < end,
            "busy": start <= time < end,
            "traffic": float(bisect_right(self._begins, time) - bisect_right(self._begins, time - TRAFFIC)),
            "reward": self._reward(time),
        }

    def command(self, now: int, command: Command) -> Command:
        """Put a line through to an outlet; where it does not ring, nothing happens."""
        self._draw_until(now)
        call = self._ringing(now)
        if call is not None and command.get("line") == call.line:
            right = command.get("outlet") == call.outlet
            left = (call.ends - now) / (call.ends - call.begins) if right else 0.0
            self._answered[call.begins] = (now, left)
            self._earned.append((now, left + (self._earned[-1][1] if self._earned else 0.0)))
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return the calls that came in."""
        self._draw_until(until)
        first, last = bisect_right(self._begins, after), bisect_right(self._begins, until)
        return [Stimulus(call.begins, call.kind) for call in self._calls[first:last]]

    def next_change(self, now: int) -> int | None:
        """Return when a call comes in, rings off or is no traffic any more, a phase begins or ends, or the lamp."""
        self._draw_until(now + TRAFFIC)
        start, end = self._phase(now)
        place, gone = bisect_right(self._begins, now), bisect_right(self._begins, now - TRAFFIC)
        call = self._ringing(now)
        times = [start - self._traffic.lead, start, end, *self._begins[place : place + 1]]
        times += [begins + TRAFFIC for begins in self._begins[gone : gone + 1]]
        times += [] if call is None else [call.ends]
        return min(time for time in times if time > now)

    def make_safe(self, now: int) -> None:
        """Do nothing: nothing moves."""

    def save(self) -> Saved:
        """Return which calls were answered when, and what was earned until then."""
        answered = [[begins, *answer] for begins, answer in self._answered.items()]
        return {"answered": answered, "earned": [list(each) for each in self._earned]}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, when it has begun."""
        self._answered = {begins: (when, left) for begins, when, left in saved["answered"]}
        self._earned = [(when, earned) for when, earned in saved["earned"]]

    def _ringing(self, time: int) -> Call | None:
        place = bisect_right(self._begins, time) - 1
        if place < 0:
            return None
        call = self._calls[place]
        answered = call.begins in self._answered and self._answered[call.begins][0] <= time
        return None if answered or time >= call.ends else call

    def _reward(self, time: int) -> float:
        place = bisect_right(self._earned, time, key=lambda earned: earned[0])
        return self._earned[place - 1][1] if place else 0.0

    def _phase(self, time: int) -> tuple[int, int]:
        """Return when the busy phase begins and ends that goes on, or comes next."""
        place = bisect_right(self._phases, time, key=lambda phase: phase[1])
        return self._phases[place]

    def _draw_until(self, time: int) -> None:
        """Draw calm and busy phases, and their calls, beyond `time`."""
        while self._drawn_until <= time + TRAFFIC:
            traffic, start = self._traffic, self._drawn_until
            busy = start + self._uniform(traffic.calm)
            end = busy + self._uniform(traffic.busy)
            self._draw_calls(start, busy, traffic.calm_gap)
            if traffic.rewired and len(self._phases) % traffic.rewired == 0:
                self._rewire()
            self._draw_calls(busy, end, traffic.busy_gap)
            self._phases.append((busy, end))
            self._drawn_until = end

    def _draw_calls(self, start: int, end: int, gap: Range) -> None:
        time = start + self._uniform(gap)
        while time + self._traffic.patience < end:
            line = int(self._rng.integers(1, self._lines, endpoint=True))
            self._calls.append(Call(time, time + self._traffic.patience, line, self._wiring[line - 1]))
            self._begins.append(time)
            time += self._uniform(gap)

    def _rewire(self) -> None:
        self._wiring = self._rng.integers(0, self._outlets, self._lines).tolist()

    def _uniform(self, times: Range) -> int:
        return int(self._rng.integers(*times, endpoint=True))


def switchboard(
    *,
    lines: int = 4,
    outlets: int = 4,
    calm: Range = (6 * second, 10 * second),
    busy: Range = (3 * second, 5 * second),
    calm_gap: Range = (1500 * ms, 4500 * ms),
    busy_gap: Range = (150 * ms, 250 * ms),
    patience: Duration = 150 * ms,
    lead: Duration = 500 * ms,
    rewired: int = 6,
    sampling: Sampling | None = None,
    faults: Faults | None = None,
) -> FakeDevice:
    """A fake switchboard with calm and busy phases, whose calls are to be put through quickly and rightly."""
    if lines < 1 or outlets < 2 or rewired < 0:
        raise SpecError("a switchboard has 1 line or more and 2 outlets or more, and rewired is 0 or more.")
    for name, (least, most) in (("calm", calm), ("busy", busy), ("calm_gap", calm_gap), ("busy_gap", busy_gap)):
        if not 0 < least <= most:
            raise SpecError(f"{name} is [least, most], both above 0 and in this order.")
    if not 0 < patience <= min(calm_gap[0], busy_gap[0]) or not 0 <= lead <= calm[0]:
        raise SpecError("patience is above 0 and no longer than a gap, and lead no longer than a calm phase.")
    traffic = Traffic(calm, busy, calm_gap, busy_gap, patience, lead, rewired)
    return FakeDevice(SwitchboardWorld(lines, outlets, traffic), sampling, faults)
