"""From the table of a device to the device, or to the fake that takes its place."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from rtagent import plugins
from rtagent.device import Device, Foreseeing, Guarded
from rtagent.errors import SpecError
from rtagent.scenario.load import Part
from rtagent.scenario.model import RunTable


def build_device(part: Part, run: RunTable) -> Device:
    """Make a device, or its fake where `run` says so; raise `SpecError` where there is none, or time forbids it."""
    device: Device = plugins.build(_maker(part, run.fake), part.given())
    if run.fake and not (_fakes(part) or _is_fake(device)):
        raise SpecError(
            f"the driver {part.name!r} has no fake, so that this would move real hardware: leave out --fake, "
            "or give the driver its `fakes` (docs/drivers.md)."
        )
    if run.clock == "virtual" and isinstance(device, Guarded):
        raise SpecError(
            "hardware, and what is emulated on the wire, know no virtual clock: "
            'give --fake=process, or run.clock = "real".'
        )
    return device


def _maker(part: Part, level: str) -> Callable[..., Device]:
    """Return what makes the device: its driver, or the driver's fake of a level."""
    fakes = _fakes(part)
    if not level or not fakes:
        return part.plugin
    if level not in fakes:
        there = " or ".join(f"--fake={name}" for name in fakes)
        raise SpecError(f"the driver {part.name!r} has no fake of the level {level!r}: give {there}.")
    return fakes[level]


def _fakes(part: Part) -> Mapping[str, Callable[..., Device]]:
    fakes: Mapping[str, Callable[..., Device]] = getattr(part.plugin, "fakes", {})
    return fakes


def _is_fake(device: Device) -> bool:
    """Say whether a device is a function of the clock, or of what it is told, and so no hardware."""
    return isinstance(device, Foreseeing) or device.spec.synchronous
