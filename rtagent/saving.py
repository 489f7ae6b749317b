"""Saving and restoring the state of objects, exactly: plain arrays, numbers and texts by their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from rtagent.errors import SpecError

Saved = dict[str, Any]
"""Names to arrays (copies), numbers, texts, None, or further `Saved`: nothing that would need pickle."""


@runtime_checkable
class Saveable(Protocol):
    """What can be saved: restoring into an object made with the same settings goes on as if nothing had been."""

    def save(self) -> Saved:
        """Return the state; nothing that happens later changes it."""

    def restore(self, saved: Saved) -> None:
        """Take a saved state; raise `SpecError`, changing nothing, where it is of another shape."""


def save_fields(owner: object, names: Sequence[str]) -> Saved:
    """Return these attributes, arrays, dictionaries and lists copied."""
    return {name: _copied(getattr(owner, name)) for name in names}


def restore_fields(owner: object, names: Sequence[str], saved: Saved) -> None:
    """Set these attributes, arrays in place; raise `SpecError` before the first where one does not fit."""
    for name in names:
        if name not in saved:
            raise SpecError(f"the saved state of {type(owner).__name__} has no {name!r}: it is of something else.")
        _check_fit(owner, name, saved[name])
    for name in names:
        current, value = getattr(owner, name), saved[name]
        if isinstance(current, np.ndarray):
            current[...] = value
        else:
            setattr(owner, name, _copied(value))


def _copied(value: Any) -> Any:
    return value.copy() if isinstance(value, np.ndarray | dict | list) else value


def _check_fit(owner: object, name: str, value: Any) -> None:
    current = getattr(owner, name)
    if not isinstance(current, np.ndarray):
        return
    shape, dtype = np.shape(value), getattr(value, "dtype", None)
    if (shape, dtype) != (current.shape, current.dtype):
        raise SpecError(
            f"{name} of the saved {type(owner).__name__} is {dtype} of shape {shape}, "
            f"not {current.dtype} of shape {current.shape}: it was saved with other settings."
        )


def save_parts(parts: Mapping[str, Saveable]) -> Saved:
    """Return the states of several objects by their names."""
    return {name: part.save() for name, part in parts.items()}


def restore_parts(parts: Mapping[str, Saveable], saved: Saved) -> None:
    """Restore each of them; raise `SpecError`, with all as they were, where one does not fit."""
    before = save_parts(parts)
    try:
        for name, part in parts.items():
            if name not in saved:
                raise SpecError(f"the saved state has no {name!r}: it is of something else.")
            part.restore(saved[name])
    except SpecError:
        for name, part in parts.items():
            part.restore(before[name])
        raise
