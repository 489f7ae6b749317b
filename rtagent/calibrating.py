"""Calibration of a device by a person who moves it by hand: what a driver may ask of the person."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Protocol

Live = Callable[[], Mapping[str, str]]
"""What is to be seen meanwhile, by name."""


class Person(Protocol):
    """Somebody at the device."""

    async def does(self, instruction: str, live: Live) -> None:
        """Show an instruction and what is `live`, until the person says that it is done.

        Raises `SpecError` where the person has gone.
        """


Calibration = Callable[..., Awaitable[str]]
"""A plug-in of the group `rtagent.calibrations`, by the name of its driver: called with a person and the settings
of the device, it leads the person through, writes down what it finds out, and returns a sentence on that."""
