"""From a scenario to the telemetry of its run."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial

from rtagent.device import Pressable
from rtagent.latch import Latch
from rtagent.scenario import Assembly, Scenario
from rtagent.scenario.model import TelemetryTable
from rtagent.schedule import Schedule
from rtagent.telemetry.connection import Access
from rtagent.telemetry.describing import about_run
from rtagent.telemetry.keys import Place, as_chunk
from rtagent.telemetry.link import Link, Wishes, time_of_day
from rtagent.telemetry.lull import Pace


def open_telemetry(scenario: Scenario, assembly: Assembly, latch: Latch, record: str | None) -> Link:
    """Return the telemetry of a run, published as its scenario says, and recorded in the file `record`."""
    table = scenario.model.telemetry
    wishes = Wishes(
        access_of(table) if scenario.model.published else None,
        os.path.abspath(record) if record else "",  # noqa: PTH100  # a path's resolve would follow links
        table.buffer,
        _commands(assembly, latch) if table.control else {},
    )
    place = Place(as_chunk(scenario.name), f"{time_of_day()}-{os.getpid()}")
    return Link(about_run(scenario, assembly), place, wishes, pace_of(assembly.schedule))


def pace_of(schedule: Schedule) -> Pace:
    """Return how a schedule paces a run."""
    return Pace(schedule.period, schedule.order[0])


def access_of(table: TelemetryTable) -> Access:
    """Return where the telemetry of a scenario goes."""
    return Access(**{name: getattr(table, name) for name in Access.__struct_fields__})


def _commands(assembly: Assembly, latch: Latch) -> Mapping[str, Callable[[str], None]]:
    """Return what a viewer may do to a run."""
    return {
        "stop": lambda text: latch.trip("telemetry", text or "a viewer asked for it"),
        "annotate": lambda text: None,  # it is only recorded
        "press": partial(_press, assembly),
    }


def _press(assembly: Assembly, text: str) -> None:
    device = assembly.devices[text]
    if isinstance(device, Pressable):
        device.press()
