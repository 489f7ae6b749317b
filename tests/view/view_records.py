"""Records for the tests of the view, as a run would publish them."""

from __future__ import annotations

from typing import Any

from rtagent.telemetry import records
from rtagent.telemetry.records import STREAMS, DemonAbout, DeviceSignals, Record, Signal
from rtagent.telemetry.subscribe import Message
from rtagent.view.seen import SeenRun

USUAL: dict[str, dict[str, Any]] = {
    "sample": {
        "device": "joint", "number": 1, "values": {"x": 1.0}, "world_time_ns": 0, "arrival_time_ns": 0,
        "time_source": "device",
    },
    "transition": {
        "action": 0, "next_action": None, "probability": 1.0, "reward": 0.0, "elapsed_ns": 1, "terminated": False,
        "truncated": False, "state": [0.0, 0.0], "next_state": [0.0, 0.0], "complete_at_ns": 0, "delta": None,
    },
}  # fmt: skip
"""What is not said of a record."""


def run_record(demons: list[DemonAbout] | None = None, began: int = 0, ended: str = "") -> records.Run:
    signal = Signal("float64", [], "rad", None, None)
    return records.Run(
        sequence=0, time_ns=began, agent="arm", run="1", epoch_ns=0, clock="real", seed=1, scenario={}, machine={},
        versions={}, devices={"joint": DeviceSignals({"x": signal, "y": signal}, {}, 0.0)}, state=["x", "z"],
        actions=["go", "stop"], demons=demons or [], buttons=[], control=True, ended=ended,
    )  # fmt: skip


def take(
    run: SeenRun, stream: str, sequence: int, *, time: int = 0, missed: int = 0, record: Record | None = None,
    **fields: Any,
) -> None:  # fmt: skip
    """Have a run take a record."""
    if record is None:
        usual = USUAL.get(stream, {})
        usual = usual | {name: time for name in ("complete_at_ns", "arrival_time_ns") if name in usual}
        record = STREAMS[stream](sequence=sequence, time_ns=time, **(usual | fields))
    run.take(Message("arm", "1", stream, record, missed))


def seen_run(demons: list[DemonAbout] | None = None, began: int = 0) -> SeenRun:
    """Return a run that began."""
    run = SeenRun()
    take(run, "run", 0, record=run_record(demons, began))
    return run
