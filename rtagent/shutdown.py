"""The end of all devices: made safe and closed, all at once, each within its time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence

from rtagent.device import Unhurried
from rtagent.supervision import SupervisedDevice
from rtagent.units import describe, second

SAFE_WITHIN = 1 * second
"""How long a device may take to become safe that does not say otherwise, and any device to close."""

Call = Callable[[SupervisedDevice], Awaitable[None]]


async def make_all_safe(devices: Sequence[SupervisedDevice]) -> dict[str, str]:
    """Make every device safe, all at once, each within its time; return, by name, a sentence for each failure."""
    calls = [_attempt(device, _make_safe, safe_within(device.device), "made safe") for device in devices]
    found = zip(devices, await asyncio.gather(*calls), strict=True)
    return {device.name: sentence for device, sentence in found if sentence}


async def close_all(devices: Sequence[SupervisedDevice]) -> list[str]:
    """Close every device, all at once, each within a second; return a sentence for each that failed."""
    calls = (_attempt(device, _close, SAFE_WITHIN, "closed") for device in devices)
    return [sentence for sentence in await asyncio.gather(*calls) if sentence]


def safe_within(device: object) -> int:
    """Return how long (ns) a device may take to become safe."""
    return device.safe_within if isinstance(device, Unhurried) else SAFE_WITHIN


async def _make_safe(device: SupervisedDevice) -> None:
    await device.make_safe()


async def _close(device: SupervisedDevice) -> None:
    await device.device.close()


async def _attempt(device: SupervisedDevice, call: Call, within: int, what: str) -> str:
    """Call, and wait `within` (ns); return a sentence where that failed."""
    calling = asyncio.ensure_future(call(device))
    _, late = await asyncio.wait({calling}, timeout=within / second)
    failure = f"device {device.name!r} could not be {what}"
    if late:
        calling.cancel()
        return f"{failure} within {describe(within)}: it does not answer."
    error = asyncio.CancelledError() if calling.cancelled() else calling.exception()
    return "" if error is None else f"{failure}: {error!r}."
