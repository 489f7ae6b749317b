"""How what happened goes through the buffer: MessagePack, with arrays as their bytes."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

ARRAY = 1


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return msgspec.msgpack.Ext(ARRAY, _encode((value.dtype.str, value.shape, value.tobytes())))
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"telemetry has no form for {type(value).__name__}")


def _listed(code: int, data: memoryview) -> Any:
    dtype, shape, content = msgspec.msgpack.decode(data)
    return np.frombuffer(content, dtype).reshape(shape).tolist()


_encode = msgspec.msgpack.Encoder().encode
pack = msgspec.msgpack.Encoder(enc_hook=_plain).encode
"""Return a value as bytes; named tuples become lists."""
unpack = msgspec.msgpack.Decoder(ext_hook=_listed).decode
"""Return what was packed; arrays become lists."""
