"""What the camera in the hand's palm sees of the grasping experiment: rectangles of one colour before a wall."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtagent.experience import FloatArray
from rtagent_drivers.grasping import assumed
from rtagent_drivers.grasping.noise import bits, salt, uniform
from rtagent_drivers.grasping.session import CLOSES, RELEASES, Session, Times, share

Pixels = NDArray[np.int64]
LIGHT = salt("light")


class Part(NamedTuple):
    """A rectangle at each of n times: its sides in pixels, shape (n,), and its colour, shape (n, 3), 0 to 255."""

    top: Pixels
    bottom: Pixels
    left: Pixels
    right: Pixels
    colour: Pixels


class View:
    """The object, which comes from above, and the hand's thumb at the left; pictures are of `size` pixels."""

    def __init__(self, session: Session, size: tuple[int, int]) -> None:
        self._session, rng = session, session.view_rng
        self._width, self._height = size
        self._sizes = 1.0 + assumed.SIZE_SPREAD * np.clip(rng.normal(size=len(session)), -2.5, 2.5)
        self._light = 1.0 + assumed.LIGHT * rng.normal(size=len(session))
        halves = np.array([[assumed.WIDTH, assumed.WIDTH], [assumed.WIDER, assumed.NARROWER]])
        self._widths: FloatArray = halves[session.stepped.astype(int)].T * self._sizes
        self._colours = np.where(session.green[:, None], assumed.GREEN, assumed.ORANGE)

    def parts(self, times: Times) -> Iterator[Part]:
        """Yield the upper and the lower half of the object, and the thumb; they do not overlap."""
        trial, since = self._session.at(times)
        light = (self._light[trial] + assumed.FLICKER * (2.0 * uniform(bits(times, LIGHT)) - 1.0))[:, None]
        colour = _bytes(self._colours[trial] * light)
        takes = assumed.TURNING
        inside = share(since, self._session.enters[trial], takes) - share(since, self._session.leaves[trial], takes)
        end = assumed.LENGTH * inside
        middle, nothing = np.maximum(0.0, end - assumed.LENGTH / 2), np.zeros(len(times))
        for top, bottom, width in ((nothing, middle, self._widths[0]), (middle, end, self._widths[1])):
            yield self._part((top, bottom), (0.5 - width[trial] / 2, 0.5 + width[trial] / 2), colour)
        thumb = _bytes(np.array(assumed.THUMB) * light)
        rows = nothing + assumed.THUMB_TOP, nothing + assumed.THUMB_BOTTOM
        yield self._part(rows, (nothing, self._thumb(trial, since)), thumb)

    def means(self, times: Times) -> FloatArray:
        """Return the mean red, green and blue of the pictures, shape (3, n), 0 to 1."""
        wall = np.array(assumed.WALL)[:, None]
        total = np.zeros((3, len(times))) + wall * (self._width * self._height)
        for part in self.parts(times):
            area = np.maximum(0, part.bottom - part.top) * np.maximum(0, part.right - part.left)
            total += (part.colour.T - wall) * area
        means: FloatArray = total / (255.0 * self._width * self._height)
        return means

    def _thumb(self, trial: Pixels, since: Times) -> FloatArray:
        """Return how far the thumb reaches into the picture."""
        closed = np.where(self._session.stepped[trial], assumed.THUMB_ON_STEP, assumed.THUMB_ON_CYLINDER)
        grasps = share(since, CLOSES, assumed.CLOSING) - share(since, RELEASES, assumed.CLOSING)
        reach: FloatArray = assumed.THUMB_OPEN + (closed - assumed.THUMB_OPEN) * grasps
        return reach

    def _part(
        self, rows: tuple[FloatArray, FloatArray], columns: tuple[FloatArray, FloatArray], colour: Pixels
    ) -> Part:
        """Return a part from its sides as fractions of the picture's; those across fall between pairs of pixels."""
        top, bottom = (np.rint(each * self._height).astype(np.int64) for each in rows)
        left, right = (2 * np.rint(each * self._width / 2).astype(np.int64) for each in columns)
        return Part(top, bottom, left, right, colour)


def _bytes(colours: FloatArray) -> Pixels:
    return np.rint(np.clip(colours, 0.0, 255.0)).astype(np.int64)
