"""JPEG pictures, decoded by OpenCV or Pillow, whichever is there; neither holds the GIL meanwhile."""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable

import numpy as np

from rtagent.errors import DeviceError, SpecError
from rtagent_drivers.webcam.pictures import BGR, RGB, Picture, Pixels, picture_of

Decoder = Callable[[bytes], Picture]


def decoder() -> Decoder:
    """Return what decodes a picture; raise `SpecError` where nothing can."""
    for module, decode in (("cv2", _by_opencv), ("PIL.Image", _by_pillow)):
        try:
            importlib.import_module(module)
        except ImportError:
            continue
        return decode
    raise SpecError(
        'the format "MJPG" needs a decoder: pip install "rtagent[webcam]" (or pillow), or take format = "YUYV".'
    )


def _by_opencv(data: bytes) -> Picture:
    import cv2

    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if pixels is None:
        raise DeviceError("the camera gave a picture that cannot be decoded.")
    return picture_of(np.asarray(pixels, np.uint8), BGR)


def _by_pillow(data: bytes) -> Picture:
    from PIL import Image, UnidentifiedImageError

    try:
        return picture_of(np.asarray(Image.open(io.BytesIO(data)).convert("RGB")), RGB)
    except (UnidentifiedImageError, OSError, ValueError) as error:
        raise DeviceError("the camera gave a picture that cannot be decoded.") from error


def encoded(pixels: Pixels) -> bytes:
    """Return pixels, shape (height, width, 3), RGB, as a JPEG picture; for fakes."""
    try:
        import cv2
    except ImportError:
        from PIL import Image

        target = io.BytesIO()
        Image.fromarray(pixels).save(target, "JPEG", quality=90)
        return target.getvalue()
    return bytes(cv2.imencode(".jpg", pixels[:, :, ::-1])[1])
