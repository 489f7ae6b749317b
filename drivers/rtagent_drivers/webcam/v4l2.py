"""The structures and requests of Video4Linux that streaming needs, as `linux/videodev2.h` lays them out.

Source: the kernel's documentation, "Video for Linux API" (user-space API, part I), on machines of 64 bits.
"""

from __future__ import annotations

import ctypes
from ctypes import c_char, c_int32, c_long, c_uint8, c_uint32, c_uint64
from typing import Final

CAPTURE: Final = 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
MMAP: Final = 1  # V4L2_MEMORY_MMAP

CAN_CAPTURE: Final = 0x00000001
CAN_STREAM: Final = 0x04000000
HAS_OWN_CAPABILITIES: Final = 0x80000000  # those of this file are in device_caps

CAN_SET_RATE: Final = 0x1000  # V4L2_CAP_TIMEPERFRAME

DAMAGED: Final = 0x00000040  # V4L2_BUF_FLAG_ERROR
CLOCK_MASK: Final = 0x0000E000  # V4L2_BUF_FLAG_TIMESTAMP_MASK
CLOCK_MONOTONIC: Final = 0x00002000


class Capability(ctypes.Structure):
    """struct v4l2_capability."""

    _fields_ = (
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class Format(ctypes.Structure):
    """struct v4l2_format with its pix (struct v4l2_pix_format)."""

    _fields_ = (
        ("type", c_uint32),
        ("_alignment", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("pixelformat", c_uint32),
        ("field", c_uint32),
        ("bytesperline", c_uint32),
        ("sizeimage", c_uint32),
        ("colorspace", c_uint32),
        ("priv", c_uint32),
        ("flags", c_uint32),
        ("ycbcr_enc", c_uint32),
        ("quantization", c_uint32),
        ("xfer_func", c_uint32),
        ("_rest", c_uint8 * 152),
    )


class FormatDescription(ctypes.Structure):
    """struct v4l2_fmtdesc."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("flags", c_uint32),
        ("description", c_char * 32),
        ("pixelformat", c_uint32),
        ("mbus_code", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class Parameters(ctypes.Structure):
    """struct v4l2_streamparm with its capture (struct v4l2_captureparm)."""

    _fields_ = (
        ("type", c_uint32),
        ("capability", c_uint32),
        ("capturemode", c_uint32),
        ("numerator", c_uint32),
        ("denominator", c_uint32),
        ("extendedmode", c_uint32),
        ("readbuffers", c_uint32),
        ("_rest", c_uint8 * 176),
    )


class BufferRequest(ctypes.Structure):
    """struct v4l2_requestbuffers."""

    _fields_ = (
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint32),
    )


class Buffer(ctypes.Structure):
    """struct v4l2_buffer."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("seconds", c_long),
        ("microseconds", c_long),
        ("timecode", c_uint8 * 16),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("offset", c_uint64),  # of the union m; the others are as long
        ("length", c_uint32),
        ("reserved2", c_uint32),
        ("request_fd", c_int32),
    )


class Control(ctypes.Structure):
    """struct v4l2_control."""

    _fields_ = (("id", c_uint32), ("value", c_int32))


class ControlQuery(ctypes.Structure):
    """struct v4l2_queryctrl."""

    _fields_ = (
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_char * 32),
        ("minimum", c_int32),
        ("maximum", c_int32),
        ("step", c_int32),
        ("default_value", c_int32),
        ("flags", c_uint32),
        ("reserved", c_uint32 * 2),
    )


def _request(number: int, size: int, *, writes: bool, reads: bool) -> int:
    """Return the number of an ioctl as `asm-generic/ioctl.h` builds it."""
    return (int(reads) << 31) | (int(writes) << 30) | (size << 16) | (ord("V") << 8) | number


def _both_ways(number: int, structure: type[ctypes.Structure]) -> int:
    return _request(number, ctypes.sizeof(structure), writes=True, reads=True)


QUERYCAP: Final = _request(0, ctypes.sizeof(Capability), writes=False, reads=True)
ENUM_FMT: Final = _both_ways(2, FormatDescription)
S_FMT: Final = _both_ways(5, Format)
REQBUFS: Final = _both_ways(8, BufferRequest)
QUERYBUF: Final = _both_ways(9, Buffer)
QBUF: Final = _both_ways(15, Buffer)
DQBUF: Final = _both_ways(17, Buffer)
STREAMON: Final = _request(18, 4, writes=True, reads=False)
STREAMOFF: Final = _request(19, 4, writes=True, reads=False)
S_PARM: Final = _both_ways(22, Parameters)
S_CTRL: Final = _both_ways(28, Control)
QUERYCTRL: Final = _both_ways(36, ControlQuery)


def fourcc(name: str) -> int:
    """Return the number of a pixel format such as "YUYV"."""
    return int.from_bytes(name.encode("ascii"), "little")


def fourcc_name(number: int) -> str:
    """Return the name of a pixel format."""
    return number.to_bytes(4, "little").decode("ascii", "replace").strip()
