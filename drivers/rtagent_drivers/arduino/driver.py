"""The driver `arduino`: from settings to a device, or to its fakes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

from rtagent.device import Device
from rtagent.units import Baud, Duration, Frequency, ms
from rtagent_drivers.arduino.device import Arduino, ArduinoWithServos
from rtagent_drivers.arduino.layouts import Format
from rtagent_drivers.arduino.settings import Channel, FakeSettings, Servo, Settings, Stop


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
