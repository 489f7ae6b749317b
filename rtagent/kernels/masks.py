"""64 comparisons at once, as the bits of a number: the compiler makes no such thing of a loop by itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

WIDTH = 64
_LANES = ir.VectorType(ir.FloatType(), WIDTH)
_UNDEFINED = ir.Constant(_LANES, ir.Undefined)


def _within_limit(typing: Any, values: Any, start: Any, limit: Any) -> Any:
    """Return which of the 64 float32 `values` from `start` on are at most `limit`, the first in the lowest bit."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        place = builder.bitcast(builder.gep(array.data, [arguments[1]]), _LANES.as_pointer())
        lanes = builder.load(place, align=4)
        first = builder.insert_element(_UNDEFINED, arguments[2], ir.Constant(ir.IntType(32), 0))
        limits = builder.shuffle_vector(first, _UNDEFINED, ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), None))
        return builder.bitcast(builder.fcmp_ordered("<=", lanes, limits), ir.IntType(WIDTH))

    return types.uint64(values, types.int64, types.float32), generate


def _lowest_bit(typing: Any, bits: Any) -> Any:
    """Return the place of the lowest bit that is set; there must be one."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), generate


within_limit = cast("Callable[[NDArray[np.float32], int, np.float32], np.uint64]", intrinsic(_within_limit))
lowest_bit = cast("Callable[[np.uint64], int]", intrinsic(_lowest_bit))
