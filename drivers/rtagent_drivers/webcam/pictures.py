"""Pictures as cameras give them, and averages of them; colour is converted once averages are taken.

Averaging and the conversion from YUV to RGB are both linear, so that their order changes nothing, and three numbers
are converted in place of a million. Only what lies outside of RGB is clipped later than it would be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtagent.experience import FloatArray

Pixels = NDArray[np.uint8]
Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""


ROWS = 256
"""The sum of so many bytes fits into 16 bits, which is three times as quick as 32."""


@dataclass(frozen=True, eq=False)
class Layout:
    """How pixels are bytes: groups of `group` bytes, each of `across` pixels side by side.

    The red, green and blue (0 to 1) of a group are `matrix` @ its bytes + `offset`.
    """

    group: int
    across: int
    matrix: FloatArray
    offset: FloatArray

    def colour(self, groups: FloatArray) -> FloatArray:
        """Return red, green and blue, shape (…, 3), each 0 to 1, of averaged groups, shape (…, group)."""
        return np.clip(groups @ self.matrix.T + self.offset, 0.0, 1.0)

    def bytes_of(self, colour: Colour) -> Pixels:
        """Return the bytes, shape (group,), of pixels of one colour."""
        groups = np.linalg.pinv(self.matrix) @ (np.array(colour) / 255 - self.offset)
        return groups.round().clip(0, 255).astype(np.uint8)


TO_YUV = np.array([[65.481, 128.553, 24.966], [-37.797, -74.203, 112.0], [112.0, -93.786, -18.214]])
"""Y, U and V (less 16, 128 and 128) of red, green and blue (0 to 1): ITU-R BT.601 in its limited range."""


def _yuyv() -> Layout:
    """YUYV, which a camera of V4L2 means in BT.601 and the limited range where it says nothing else."""
    of_yuv = np.linalg.inv(TO_YUV)
    matrix = of_yuv[:, [0, 1, 0, 2]] * (0.5, 1.0, 0.5, 1.0)
    return Layout(4, 2, matrix, -of_yuv @ (16.0, 128.0, 128.0))


YUYV = _yuyv()
RGB = Layout(3, 1, np.eye(3) / 255, np.zeros(3))
BGR = Layout(3, 1, np.eye(3)[::-1] / 255, np.zeros(3))


@dataclass(frozen=True)
class Rectangle:
    """A part of a picture, in pixels from its upper left corner."""

    left: int
    top: int
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of `width` pixels: `rows`, shape (height, bytes of a row, at least as many as the width needs)."""

    rows: Pixels
    width: int
    layout: Layout

    def mean(self, part: Rectangle) -> list[float]:
        """Return the mean red, green and blue (0 to 1) of a part; its sides are rounded to whole groups."""
        first = part.left // self.layout.across
        last = max(first + 1, (part.left + part.width) // self.layout.across)
        sums = self._sums(part.top, part.top + part.height)[first:last].sum(axis=0)
        colour: list[float] = self.layout.colour(sums / ((last - first) * part.height)).tolist()
        return colour

    def reduced(self, shape: Sequence[int]) -> FloatArray:
        """Return it with fewer pixels, `shape` (rows, columns): each the mean colour of what it covers."""
        height = len(self.rows)
        groups = self.width // self.layout.across
        tops, lefts = _edges(height, shape[0]), _edges(groups, shape[1])
        counts = np.diff(lefts)[:, None]
        bands = [
            np.add.reduceat(self._sums(top, bottom), lefts[:-1], axis=0) / (counts * (bottom - top))
            for top, bottom in zip(tops[:-1].tolist(), tops[1:].tolist(), strict=True)
        ]
        return self.layout.colour(np.array(bands))

    def _sums(self, top: int, bottom: int) -> NDArray[Any]:
        """Return the sums of the rows from `top` to `bottom`, shape (groups of a row, bytes of a group)."""
        used = self.width // self.layout.across * self.layout.group
        sums = np.zeros(used, np.uint32)
        for first in range(top, bottom, ROWS):
            sums += np.add.reduce(self.rows[first : min(first + ROWS, bottom), :used], axis=0, dtype=np.uint16)
        return sums.reshape(-1, self.layout.group)


def _edges(length: int, parts: int) -> NDArray[np.int64]:
    return np.arange(parts + 1) * length // parts


def picture_of(pixels: Pixels, layout: Layout = RGB) -> Picture:
    """Return pixels of shape (height, width, 3) as a picture."""
    return Picture(pixels.reshape(len(pixels), -1), pixels.shape[1], layout)


def as_yuyv(pixels: Pixels) -> Pixels:
    """Return pixels, shape (height, an even width, 3), as bytes of YUYV, shape (height, 2 · width)."""
    height, width, _ = pixels.shape
    yuv = pixels.astype(np.float64) @ (TO_YUV / 255).T + (16.0, 128.0, 128.0)
    pairs = yuv.reshape(height, width // 2, 2, 3)
    groups = np.stack(
        [pairs[:, :, 0, 0], pairs[:, :, :, 1].mean(2), pairs[:, :, 1, 0], pairs[:, :, :, 2].mean(2)], axis=2
    )
    return groups.round().clip(0, 255).astype(np.uint8).reshape(height, 2 * width)
