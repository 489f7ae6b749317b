"""What a device is: the contract between the runtime and the drivers.

`rtagent.testing.DeviceContract` checks a driver against it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from numpy.random import Generator

from rtagent.experience import Command, Sample, Stimulus
from rtagent.specs import DeviceSpec


class Device(Protocol):
    """An async driver for one piece of hardware, or its fake.

    Any of its methods may raise `DeviceError` (tried again within the retry budget) or `DisconnectedError`
    (opened anew), and any may be cancelled while it waits.
    """

    spec: DeviceSpec

    async def open(self) -> None:
        """Connect; nothing moves yet."""

    async def read(self, newer_than: int) -> Sample:
        """Return the newest sample, at once if its sequence number is above `newer_than`, else when one is.

        `newer_than` is -1 for whatever is newest, which an event device gives at once, each time the same.
        """

    async def act(self, command: Command) -> Command:
        """Send `command`, a value for each actuator that it names; return what was sent, after limits."""

    async def make_safe(self) -> None:
        """Put every actuator in its safe state; may be called at any time, and more than once."""

    async def close(self) -> None:
        """Let go of the hardware; may be called more than once. The device can be opened again."""


@runtime_checkable
class Episodic(Protocol):
    """A device that can be brought to the start of an episode."""

    async def begin_episode(self, rng: Generator) -> None:
        """Go to the start; what is random in the episode is drawn from `rng`, beforehand."""


@runtime_checkable
class Finite(Protocol):
    """A device that has only so many episodes, as a recording has sessions."""

    episodes: int


@runtime_checkable
class Noting(Protocol):
    """A device that has something to say before a run, such as what it found in a file."""

    @property
    def notes(self) -> Sequence[str]:
        """Sentences on what it is, and on what may surprise."""


@runtime_checkable
class Stimulating(Protocol):
    """A device that knows when stimuli truly happened."""

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return the stimuli with after < time <= until (ns), in order."""


@runtime_checkable
class Foreseeing(Protocol):
    """A fake that knows when it will change next: the virtual clock can jump there."""

    def next_event(self, now: int) -> int | None:
        """Return the time (ns) of the next change after `now`, or None where none is to come."""


@runtime_checkable
class Pressable(Protocol):
    """A device that those who watch a run may press, where its telemetry lets them."""

    def press(self, at: int | None = None) -> None:
        """Be pressed for a moment, now or at a time (ns) that has just passed; called on the event loop."""


@runtime_checkable
class Counting(Protocol):
    """A device that counts what it dropped, retried or found damaged."""

    @property
    def counters(self) -> Mapping[str, int]:
        """The counts so far, by name."""


@dataclass(frozen=True)
class LastResort:
    """How a process that has no event loop makes a device safe, when the one that drives it cannot.

    `function` is "package.module:name"; called with `settings` (what JSON can hold) it returns a `SpareHandle`.
    `hardware` names the thing itself, such as its port by id: it is what stays latched after a stop.
    """

    function: str
    settings: Mapping[str, Any]
    hardware: str


class SpareHandle(Protocol):
    """A second way to the hardware, opened beforehand. It blocks, and needs neither asyncio nor numpy."""

    def make_safe(self) -> Sequence[str]:
        """Make it safe by its stop policy and read that back; return a sentence for each thing that is not safe."""

    def close(self) -> None:
        """Let go of the hardware."""


@runtime_checkable
class Guarded(Protocol):
    """A device that moves something real: it is watched from outside the process, and latched once stopped."""

    def last_resort(self) -> LastResort:
        """Return how to make it safe from outside; asked again after each `open`, when a port may have been found.

        Raises `DeviceError` where nothing is found that could be made safe.
        """


@runtime_checkable
class Unhurried(Protocol):
    """A device that may need longer than a second to become safe, as for its way home."""

    safe_within: int
    """How long (ns) `make_safe` may take."""


@runtime_checkable
class Impatient(Protocol):
    """A device whose hardware stops by itself where it hears nothing for a while."""

    tolerates: int
    """How long (ns) that is (0: it does not stop by itself)."""
