"""Somebody who presses a button now and then: when, for how long."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from numpy.random import Generator

from rtagent.errors import SpecError
from rtagent.units import Duration, ms, second
from rtagent_drivers.fake import CLOSED_SETTINGS


@dataclass(frozen=True)
class FakePresses:
    """Presses of a fake: the next comes `every` [least, most] after a release, and is `held` [least, most]."""

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    every: tuple[Duration, Duration] = (1 * second, 4 * second)
    held: tuple[Duration, Duration] = (80 * ms, 400 * ms)

    def __post_init__(self) -> None:
        for name, (least, most) in (("every", self.every), ("held", self.held)):
            if not 0 < least <= most:
                raise SpecError(f"fake.{name} is [least, most], both above 0 and in this order.")

    def intervals(self, rng: Generator) -> Iterator[tuple[int, int]]:
        """Yield (until the next press, until its release) in ns, without end."""
        while True:
            yield int(rng.integers(*self.every, endpoint=True)), int(rng.integers(*self.held, endpoint=True))


NOW_AND_THEN = FakePresses()
