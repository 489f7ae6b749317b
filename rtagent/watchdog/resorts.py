"""Last resorts: devices made safe by blocking calls, all at once, each in a thread of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from threading import Thread
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rtagent.device import SpareHandle


class Resort:
    """The last resort of one device; its handle is opened when it is first needed, or beforehand by `open`."""

    def __init__(self, name: str, function: str, settings: Mapping[str, Any]) -> None:
        self.name, self._function, self._settings = name, function, settings
        self._handle: SpareHandle | None = None

    def open(self) -> None:
        """Open the handle; raises what it raises."""
        if self._handle is None:
            module, _, name = self._function.partition(":")
            self._handle = getattr(import_module(module), name)(self._settings)

    def make_safe(self) -> Sequence[str]:
        """Make the device safe; return a sentence for each thing that is not."""
        try:
            self.open()
            assert self._handle is not None
            return [f"device {self.name!r}: {sentence}" for sentence in self._handle.make_safe()]
        except Exception as error:  # whatever it is: the others must be made safe too
            return [f"device {self.name!r} could not be made safe: {error!r}."]

    def close(self) -> None:
        """Close the handle."""
        if self._handle is not None:
            self._handle.close()


def make_all_safe(resorts: Sequence[Resort], within: float) -> list[Sequence[str]]:
    """Make all of them safe; return, for each, what is not. What takes longer than `within` (s) is left behind."""
    found: list[Sequence[str]] = [[f"device {resort.name!r} does not answer."] for resort in resorts]

    def run(number: int) -> None:
        found[number] = resorts[number].make_safe()

    threads = [Thread(target=run, args=(number,), daemon=True) for number in range(len(resorts))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(within)
    return found
