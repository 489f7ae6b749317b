"""What of a webcam's fakes can be set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from rtagent.units import Duration, ms
from rtagent_drivers.fake import CLOSED_SETTINGS, Faults


@dataclass(frozen=True)
class FakeCamera:
    """What a fake camera sees, and how: a scene, or a `file` of frames, played `speed` times as fast.

    A frame reaches the host `delay` after it was taken, and up to `jitter` later still.
    """

    __pydantic_config__: ClassVar[Mapping[str, object]] = CLOSED_SETTINGS

    file: str = ""
    speed: float = 1.0
    delay: Duration = 40 * ms
    jitter: Duration = 0
    faults: Faults = Faults()  # noqa: RUF009  # frozen: sharing it changes nothing


A_SCENE = FakeCamera()
