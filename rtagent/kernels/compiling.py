"""How kernels are compiled: when their module is imported, kept on disk, and without the GIL."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def kernel(*signatures: str, each: bool = False, fastmath: bool | set[str] = False) -> Callable[[F], F]:
    """Compile a function for these signatures, now; without any it is compiled for the kernels that call it.

    With `each`, the `{t}` of a signature stands for float32, and once more for float64.
    Sums keep their order, so that results do not depend on the processor, unless `fastmath` says otherwise.
    """
    kinds = ("float32", "float64") if each else ("",)
    wanted = [signature.format(t=kind) for signature in signatures for kind in kinds]

    def compiled(function: F) -> F:
        options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": fastmath}
        try:
            return cast("F", numba.njit(wanted or None, cache=True, **options)(function))
        except RuntimeError:  # no folder to keep it in can be written to
            return cast("F", numba.njit(wanted or None, **options)(function))

    return compiled
