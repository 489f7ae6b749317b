"""Devices: servos (codec, emulated bus, driver, safety), boards and webcams.

Name parts to measure only those: codec, emulator, bus, safety, arduino, webcam.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module

from _harness import Row, main

PARTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "codec": ("_codec_jobs", ("costs", "noise")),
    "emulator": ("_emulator_jobs", ("sdk_operations", "bus_times", "idling")),
    "bus": ("_bus_jobs", ("bus_rows",)),
    "safety": ("_safety_jobs", ("safety_rows",)),
    "arduino": ("_arduino_jobs", ("simulated", "clocks", "killed", "mishaps", "noise")),
    "webcam": ("_webcam_jobs", ("webcam_rows",)),
}
"""Modules of benchmarks/, and the functions in them that give rows."""


def rows(parts: Iterable[str]) -> Iterator[Row]:
    """Yield the rows of these parts, each named after its part."""
    for part in parts:
        module, functions = PARTS[part]
        for function in functions:
            measure: Callable[[], Iterable[Row]] = getattr(import_module(module), function)
            for row in measure():
                yield Row(f"{part}: {row.name}", row.value, row.unit, row.reach, row.better)


if __name__ == "__main__":
    chosen = [argument for argument in sys.argv[1:] if argument in PARTS]
    others = [argument for argument in sys.argv[1:] if argument not in PARTS]
    sys.exit(main(lambda: rows(chosen or PARTS), __doc__, others))
