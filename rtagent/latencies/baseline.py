"""Baselines: figures of scenarios in a file, to compare later ones with.

A JSON object: `format` and `version`, the `machine` and the `software` that it was measured with, and under
`scenarios` the figures of each, by its name.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from rtagent import __version__
from rtagent.checkpoint.fit import differences as settings_that_differ
from rtagent.errors import BaselineError, did_you_mean
from rtagent.latencies.figures import Figures
from rtagent.latencies.machine import Identity, differences, machine, software

FORMAT, VERSION = "rtagent latency baseline", 1
SHOWN = 3
"""So many settings are told that differ."""


@dataclass(frozen=True)
class Baseline:
    """Figures of scenarios by name, and what they were measured with; `path` is the file."""

    path: Path
    machine: Identity
    software: Identity
    rtagent: str
    scenarios: Mapping[str, Figures]

    def of(self, figures: Figures) -> Figures:
        """Return the stored figures of the same scenario; raise `BaselineError` where it has none, or another's."""
        stored = self.scenarios.get(figures.name)
        if stored is None:
            hint = did_you_mean(figures.name, list(self.scenarios))
            raise BaselineError(f"{self.path} has no figures of {figures.name}{hint}")
        if stored.digest != figures.digest:
            found = list(settings_that_differ("", stored.scenario, figures.scenario))
            more = f", and {len(found) - SHOWN} more settings differ" if len(found) > SHOWN else ""
            raise BaselineError(
                f"{self.path} has figures of another scenario of the name {figures.name}: "
                f"{'; '.join(found[:SHOWN])}{more}. Measure the same, or save a new baseline with --save."
            )
        return stored

    def times_differ_by(self) -> str:
        """Return a sentence where it was measured on another machine, so that no times can be compared; or none."""
        found = differences(self.machine, machine())
        return f"{self.path} was measured on another machine ({found}): its times are not compared." * bool(found)

    def counts_differ_by(self) -> str:
        """Return a sentence where other software ran, so that no counts can be compared; or none."""
        found = differences(self.software, software())
        return f"{self.path} was measured with other software ({found}): its counts are not compared." * bool(found)


def write(path: Path, figures: Iterable[Figures]) -> None:
    """Write figures as a baseline, whole or not at all; raises `OSError`."""
    data = {
        "format": FORMAT,
        "version": VERSION,
        "rtagent": __version__,
        "machine": machine(),
        "software": software(),
        "scenarios": {each.name: {"digest": each.digest, **msgspec.to_builtins(each)} for each in figures},
    }
    half = path.with_name(f"{path.name}.part")
    half.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    half.replace(path)


def read(path: Path) -> Baseline:
    """Read a baseline; raise `BaselineError` where it is none, or of another version of the format."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "this is not JSON"
        raise BaselineError(f"{path}: {reason}: give a file that `rtagent bench --save` has written.") from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise BaselineError(f"{path} is no baseline: give a file that `rtagent bench --save` has written.")
    if data.get("version") != VERSION:
        raise BaselineError(
            f"{path} is of version {data.get('version')} of the format, and this rtagent reads version {VERSION}: "
            "save a new one with `rtagent bench --save`."
        )
    try:
        return _baseline(path, data)
    except (msgspec.ValidationError, KeyError, AttributeError) as error:
        raise BaselineError(f"{path} is damaged ({error}): save a new one with `rtagent bench --save`.") from None


def _baseline(path: Path, data: Mapping[str, Any]) -> Baseline:
    about = {key: msgspec.convert(data[key], dict[str, str]) for key in ("machine", "software")}
    scenarios = msgspec.convert(data["scenarios"], dict[str, Figures])
    for name, figures in scenarios.items():
        if figures.digest != data["scenarios"][name]["digest"]:
            raise BaselineError(f"{path} is damaged (the digest of {name} is wrong): save a new one.")
    return Baseline(path, about["machine"], about["software"], str(data["rtagent"]), scenarios)
