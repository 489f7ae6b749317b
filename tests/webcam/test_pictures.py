"""Averages of pictures, against OpenCV's conversions and areas, and against plain means."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent.errors import DeviceError, SpecError
from rtagent_drivers.webcam.features import Features, Region
from rtagent_drivers.webcam.pictures import BGR, YUYV, Picture, Pixels, Rectangle, as_yuyv, picture_of

WIDTH, HEIGHT = 64, 600
"""Higher than sums of 16 bits are added up."""


def noise(seed: int = 1, low: int = 0, high: int = 256) -> Pixels:
    return np.random.default_rng(seed).integers(low, high, (HEIGHT, WIDTH, 3), dtype=np.uint8)


@st.composite
def rectangles(draw: st.DrawFn) -> Rectangle:
    left, top = draw(st.integers(0, WIDTH - 2)) // 2 * 2, draw(st.integers(0, HEIGHT - 1))
    width = draw(st.integers(2, WIDTH - left)) // 2 * 2
    return Rectangle(left, top, width, draw(st.integers(1, HEIGHT - top)))


@given(rectangles())
def test_a_mean_is_the_mean_of_the_pixels(part: Rectangle) -> None:
    pixels = noise()
    cut = pixels[part.top : part.top + part.height, part.left : part.left + part.width]
    expected = cut.reshape(-1, 3).mean(axis=0) / 255
    assert picture_of(pixels).mean(part) == pytest.approx(expected, abs=1e-12)
    assert picture_of(pixels, BGR).mean(part) == pytest.approx(expected[::-1], abs=1e-12)


@given(rectangles(), st.integers(0, 100))
@settings(max_examples=30)
def test_yuyv_is_converted_as_opencv_does(part: Rectangle, seed: int) -> None:
    """Colours that are within RGB in every pixel, for which averaging first changes nothing."""
    rows = as_yuyv(np.repeat(noise(seed, 60, 196)[:, ::2], 2, axis=1))
    converted = cv2.cvtColor(rows.reshape(HEIGHT, WIDTH, 2), cv2.COLOR_YUV2RGB_YUYV)
    cut = converted[part.top : part.top + part.height, part.left : part.left + part.width]
    expected = cut.reshape(-1, 3).mean(axis=0) / 255
    assert Picture(rows, WIDTH, YUYV).mean(part) == pytest.approx(expected, abs=0.6 / 255)


def test_white_is_as_large_as_the_largest_sum_can_be() -> None:
    white = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    assert picture_of(white).mean(Rectangle(0, 0, WIDTH, HEIGHT)) == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("shape", [(1, 1), (4, 8), (600, 32), (25, 16)])
def test_fewer_pixels_are_averages_of_areas_as_opencv_makes_them(shape: tuple[int, int]) -> None:
    pixels = noise(2)
    resized = cv2.resize(pixels.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA) / 255
    assert np.allclose(picture_of(pixels).reduced(shape), resized, atol=1e-5)


@pytest.mark.parametrize("shape", [(7, 5), (13, 31)])
def test_areas_that_do_not_divide_the_picture_hold_every_pixel_once(shape: tuple[int, int]) -> None:
    pixels = noise(3)
    tops, lefts = (np.arange(parts + 1) * size // parts for parts, size in zip(shape, (HEIGHT, WIDTH), strict=True))
    areas = np.diff(tops)[:, None] * np.diff(lefts)[None, :]
    reduced = picture_of(pixels).reduced(shape)
    assert (reduced * areas[:, :, None]).sum(axis=(0, 1)) / areas.sum() == pytest.approx(
        pixels.reshape(-1, 3).mean(axis=0) / 255
    )


def test_rows_may_be_longer_than_the_picture() -> None:
    pixels = noise(4)
    padded = np.concatenate([as_yuyv(pixels), np.full((HEIGHT, 10), 255, np.uint8)], axis=1)
    part = Rectangle(0, 0, WIDTH, HEIGHT)
    assert Picture(padded, WIDTH, YUYV).mean(part) == Picture(as_yuyv(pixels), WIDTH, YUYV).mean(part)


def test_what_is_sensed_fits_what_is_declared() -> None:
    features = Features((WIDTH, HEIGHT), True, {"palm": Region(2, 3, 10, 20)}, (4, 5))
    values = features(picture_of(noise()))
    assert list(values) == list(features.specs) == [
        *("red", "green", "blue", "palm_red", "palm_green", "palm_blue", "frame")
    ]  # fmt: skip
    for name, spec in features.specs.items():
        spec.validate(values[name], name)


def test_a_picture_of_another_size_is_refused() -> None:
    features = Features((WIDTH, HEIGHT), True, {}, None)
    with pytest.raises(DeviceError, match="64 × 599"):
        features(picture_of(noise()[1:]))


@pytest.mark.parametrize(
    ("regions", "frame", "sentence"),
    [
        ({"palm": Region(60, 0, 6, 1)}, None, "does not lie within"),
        ({"palm": Region(0, 0, 1, 1)}, None, "does not lie within"),
        ({"the palm": Region(0, 0, 2, 1)}, None, "needs a name"),
        ({}, (0, 4), "give \\[rows, columns\\]"),
        ({}, (4, 33), "give \\[rows, columns\\]"),
        ({}, None, "nothing is sensed"),
    ],
)
def test_what_does_not_fit_is_refused(
    regions: dict[str, Region], frame: tuple[int, int] | None, sentence: str
) -> None:
    with pytest.raises(SpecError, match=sentence):
        Features((WIDTH, HEIGHT), False, regions, frame)
