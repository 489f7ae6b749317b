"""What of a picture is sensed: mean colours of all of it and of parts, and a picture with fewer pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from rtagent.errors import DeviceError, SpecError
from rtagent.experience import Values
from rtagent.specs import Spec, Value
from rtagent_drivers.fake import CLOSED_SETTINGS
from rtagent_drivers.webcam.pictures import Picture, Rectangle

COLOURS = ("red", "green", "blue")
FRAME = "frame"
MOST_CELLS = 10_000


@dataclass(frozen=True)
class Region(Rectangle):
    """A part of the picture whose mean colour is sensed, in pixels from the upper left corner."""

    __pydantic_config__: ClassVar = CLOSED_SETTINGS


class Features:
    """What is sensed of pictures of a size.

    `means`: the mean `red`, `green` and `blue`, 0 to 1; `regions`: those of parts, as `NAME_red`, …; `frame`: the
    picture with so many (rows, columns), an array of shape (rows, columns, 3), 0 to 1. Raises `SpecError` for what
    does not fit into the picture, or where nothing is left to be sensed.
    """

    def __init__(
        self, size: tuple[int, int], means: bool, regions: Mapping[str, Region], frame: tuple[int, int] | None
    ) -> None:
        width, height = size
        for name, region in regions.items():
            _check(name, region, width, height)
        if frame is not None and not (1 <= frame[0] <= height and 1 <= frame[1] <= width // 2):
            raise SpecError(f"frame is {list(frame)}: give [rows, columns], up to [{height}, {width // 2}].")
        if frame is not None and frame[0] * frame[1] > MOST_CELLS:
            raise SpecError(f"frame is {list(frame)}: an agent is given at most {MOST_CELLS:,} pixels of a frame.")
        whole = {"": Rectangle(0, 0, width, height)} if means else {}
        parts: dict[str, Rectangle] = whole | {f"{name}_": region for name, region in regions.items()}
        self._parts = [(tuple(f"{prefix}{colour}" for colour in COLOURS), part) for prefix, part in parts.items()]
        self._size, self._frame = size, frame
        self.specs = {name: Spec(low=0.0, high=1.0) for names, _ in self._parts for name in names}
        if frame is not None:
            self.specs[FRAME] = Spec(shape=(*frame, 3), low=0.0, high=1.0)
        if not self.specs:
            raise SpecError("nothing is sensed of the picture: leave means on, or give regions or a frame.")

    def __call__(self, picture: Picture) -> Values:
        """Return what is sensed of a picture; raise `DeviceError` where it is of another size."""
        if (picture.width, len(picture.rows)) != self._size:
            raise DeviceError(f"the camera gave a picture of {picture.width} × {len(picture.rows)} pixels.")
        values: dict[str, Value] = {}
        for names, part in self._parts:
            values.update(zip(names, picture.mean(part), strict=True))
        if self._frame is not None:
            values[FRAME] = picture.reduced(self._frame)
        return values


def _check(name: str, region: Region, width: int, height: int) -> None:
    if not name.isidentifier():
        raise SpecError(f"the region {name!r} needs a name of letters, digits and underscores.")
    inside = region.left >= 0 and region.top >= 0 and region.width >= 2 and region.height >= 1
    if not inside or region.left + region.width > width or region.top + region.height > height:
        raise SpecError(
            f"the region {name!r} does not lie within the picture of {width} × {height} pixels, "
            "or is less than 2 × 1 of them."
        )
