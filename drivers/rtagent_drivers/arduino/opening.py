"""How a board is met: waited for while it starts, asked what it is, and told what is wanted of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rtagent.errors import DeviceError, SpecError
from rtagent.units import describe, ms, second
from rtagent_drivers.arduino import frames
from rtagent_drivers.arduino.layouts import LAYOUTS
from rtagent_drivers.arduino.link import Link
from rtagent_drivers.arduino.messages import Hello, Message, Scan
from rtagent_drivers.arduino.settings import BITS_A_BYTE, FRAME_BYTES, Settings, check_load

PATIENCE = 5 * second
"""A board that was reset by opening its port is in its boot loader for up to two seconds."""

ASKING = 1500 * ms
"""Between two questions: a boot loader that hears bytes more often may wait for more of them."""

ANSWERING = 300 * ms
ATTEMPTS = 3
ENOUGH = 3
"""So many whole messages prove a format."""

Clock = Callable[[], int]


async def meet(link: Link, settings: Settings, now: Clock) -> Hello | None:
    """Return what a board says that it is, or None where its format knows no hello; raise `DeviceError`."""
    ends, ask_at = now() + PATIENCE, now()
    while now() < ends:
        if settings.layout.legacy and link.kept:
            return None
        if (hello := _newest_hello(link.kept)) is not None:
            return hello
        _check_format(link, settings)
        if not settings.layout.legacy and now() >= ask_at:
            link.write(frames.ASK)
            ask_at = now() + ASKING
        await link.news(50 * ms)
    raise DeviceError(_what_is_wrong(link, settings))


async def configure(link: Link, settings: Settings, hello: Hello, now: Clock) -> Hello:
    """Have a board measure and guard as `settings` say; return what it says then. Raises `DeviceError`."""
    check_board(settings, hello)
    for _ in range(ATTEMPTS):
        if is_configured(hello, settings):
            check_time(settings, hello)
            return hello
        link.kept.clear()
        link.write(configuration(settings))
        ends = now() + ANSWERING
        while now() < ends and _newest_hello(link.kept) is None:
            await link.news(ends - now())
        hello = _newest_hello(link.kept) or hello
    raise DeviceError(
        f"the board at {settings.port} does not take its settings: reset it, or upload its sketch anew."
    )


def configuration(settings: Settings) -> bytes:
    """Return what tells a board its settings."""
    return frames.configure(settings.period, settings.heartbeat, holds=settings.stop == "hold")


def check_board(settings: Settings, hello: Hello) -> None:
    """Raise `DeviceError` where a board has not what its settings name."""
    if hello.version != frames.VERSION:
        raise DeviceError(
            f"the board's sketch speaks version {hello.version} of the frames, this driver {frames.VERSION}: "
            "upload the sketch of this version (docs/arduino.md)."
        )
    _check_pins("channels", settings.pins, hello.channels)
    _check_pins("servos", [str(servo.pin) for servo in settings.servos.values()], list(map(str, hello.servos)))
    try:
        check_load(len(hello.channels), settings.hertz, 0 if settings.baud == "usb" else settings.bits)
    except SpecError as error:
        raise DeviceError(f"the board sends all its channels: {error}") from error


def check_time(settings: Settings, hello: Hello) -> None:
    """Raise `DeviceError` where a board cannot measure as often as it is to."""
    if hello.scan > settings.period:
        raise DeviceError(
            f"the board takes {describe(hello.scan)} for its {len(hello.channels)} channels, but is to measure "
            f"them every {describe(settings.period)}: lower the rate, or have the sketch measure fewer."
        )


def latency(settings: Settings, hello: Hello | None) -> int:
    """Return how long (ns) after its time a scan is here at the earliest."""
    if hello is None:
        return 0
    sent = (FRAME_BYTES + 2 * len(hello.channels)) * BITS_A_BYTE * second // settings.bits
    return hello.lag + (0 if settings.baud == "usb" else sent)


def is_configured(hello: Hello, settings: Settings) -> bool:
    """Return whether a board measures and guards as `settings` say."""
    wanted = settings.period, settings.heartbeat // ms * ms, settings.stop == "hold"
    return (hello.period, hello.heartbeat, hello.holds) == wanted


def _check_pins(what: str, wanted: Sequence[str], there: Sequence[str]) -> None:
    missing = [pin for pin in wanted if pin not in there]
    if missing:
        has = ", ".join(there) or "none"
        raise DeviceError(
            f"the board's sketch has no {what} on {', '.join(missing)}; it has {has}. "
            "Upload the sketch that this scenario is for, or change its pins."
        )


def _newest_hello(messages: Sequence[Message]) -> Hello | None:
    return next((each for each in reversed(messages) if isinstance(each, Hello)), None)


def _check_format(link: Link, settings: Settings) -> None:
    """Raise `DeviceError` as soon as it is clear that a board speaks another format."""
    spoken = spoken_format(link.raw)
    if spoken and spoken != settings.format:
        cure = "upload one of the sketches in firmware/" if settings.format == "rtagent" else "upload its sketch"
        raise DeviceError(
            f"the board at {settings.port} speaks the format {spoken!r}, not {settings.format!r}: "
            f'set format = "{spoken}", or {cure}.'
        )


def spoken_format(raw: bytes) -> str:
    """Return the name of the format that bytes are in, or nothing where they are in none."""
    for name, layout in LAYOUTS.items():
        messages = [each for each in layout.decoder().feed(raw) if isinstance(each, Scan | Hello)]
        if len(messages) >= ENOUGH:
            return name
    return ""


def _what_is_wrong(link: Link, settings: Settings) -> str:
    where = f"{settings.port} within {describe(PATIENCE)}"
    if not link.raw:
        return (
            f"nothing came from the board at {where}: is it the right port, has the board power, "
            "and was a sketch uploaded (docs/arduino.md)?"
        )
    if settings.layout.legacy or not spoken_format(link.raw):
        return (
            f"{len(link.raw)} bytes came from the board at {where}, but at {settings.bits} baud they make no "
            "sense: its sketch uses another baud rate, or is another sketch."
        )
    return (
        f"the board at {where} sent scans but no hello, though it was asked: reset it, or upload its sketch anew."
    )
