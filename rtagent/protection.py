"""What protects people and hardware during a run with guarded devices: watchdog, latches that stay, and a register.

A run in which nothing is guarded, or one under the virtual clock, has none of it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from rtagent import latched, living
from rtagent.device import Device, Guarded
from rtagent.errors import DeviceError, StoppedError
from rtagent.latch import Latch
from rtagent.units import ms
from rtagent.watchdog.process import WatchdogProcess


@dataclass(frozen=True)
class Watchdog:
    """`timeout` (ns) without a heartbeat of the event loop makes it act; `scenario` is what it tells of the run."""

    timeout: int = 100 * ms
    scenario: str = ""


WATCHDOG = Watchdog()


class Protection:
    """Protects the guarded ones among `devices`; `told` is called with what the watchdog has done."""

    def __init__(
        self, devices: Mapping[str, Device], watchdog: Watchdog, latch: Latch, told: Callable[[str], None]
    ) -> None:
        self._guarded = {name: device for name, device in devices.items() if isinstance(device, Guarded)}
        self._watchdog, self._latch, self._told = watchdog, latch, told
        self._stack = contextlib.ExitStack()
        self._process: WatchdogProcess | None = None
        self.begun = False
        """Whether anything may have moved, so that ending early latches the hardware."""
        self._look_for_hardware()
        self._refuse_latched()

    @property
    def needed(self) -> bool:
        """Whether anything is guarded."""
        return bool(self._guarded)

    async def arm(self) -> None:
        """Begin to protect, when the devices are open and nothing has moved; raise an error where that fails."""
        self._look_for_hardware()
        self._refuse_latched()
        if self._latch.fd < 0:
            raise DeviceError("this system has no shared memory for the watchdog, so nothing may move: use Linux.")
        self._stack.enter_context(living.told(self._watchdog.scenario, self._hardware()))
        process = WatchdogProcess(self._watchdog.timeout, self._watchdog.scenario, self._latch, self._told)
        self._process = process
        await process.start(self._resorts)

    async def renew(self) -> None:
        """Have the watchdog reach devices where they are now: after one was opened anew."""
        if self._process is not None:
            self._look_for_hardware()
            await self._process.guard(self._resorts)

    async def save(self, failed: Mapping[str, str]) -> list[str]:
        """Have the watchdog make safe what failed to be, by the names of devices; return what is still not safe."""
        found: Mapping[str, list[str]] = {}
        if self._process is not None and failed.keys() & self._guarded.keys():
            with contextlib.suppress(DeviceError):
                found = await self._process.make_safe()
        return [each for name, sentence in failed.items() for each in found.get(name, [sentence])]

    async def end(self, why: str) -> None:
        """End it, when everything was made safe; say `why` where the run was ended early: this stays latched."""
        if why and self.begun:
            self._keep_latched(why)
        process, self._process = self._process, None
        if process is not None:
            await process.end()
        self._stack.close()

    def _keep_latched(self, why: str) -> None:
        for hardware in self._hardware():
            try:
                latched.latch(hardware, why, self._watchdog.scenario)
            except OSError as error:
                self._told(f"that {hardware} is latched cannot be kept: {error}")

    def _look_for_hardware(self) -> None:
        """Note where it is now: at the end of a run it may not be there any more."""
        self._resorts = {name: device.last_resort() for name, device in self._guarded.items()}

    def _hardware(self) -> list[str]:
        return [resort.hardware for resort in self._resorts.values()]

    def _refuse_latched(self) -> None:
        entries = [entry for hardware in self._hardware() if (entry := latched.find(hardware)) is not None]
        if entries:
            raise StoppedError(
                f"{'; '.join(map(str, entries))}. See that everybody is clear of it, then run "
                f"`rtagent rearm {self._watchdog.scenario or 'SCENARIO'}`."
            )
