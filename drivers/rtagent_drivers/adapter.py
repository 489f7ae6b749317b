"""What is to be known of a serial adapter before anything is asked of what hangs on it: `rtagent devices`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from serial.tools.list_ports import comports

from rtagent.finding import Finding, Search
from rtagent_drivers.serial_line import group_of, holders, latency_timer

PSEUDO_TERMINALS = "/dev/pts/"
"""Whoever made one has it open too, and no adapter delays what it says."""

UDEV_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", ATTR{latency_timer}="1"'
UDEV_FILE = "/etc/udev/rules.d/99-latency-timer.rules"


async def probe(port: str, search: Search) -> Sequence[Finding]:
    """Return what kind of port it is, whether it may be opened, who has it open, and how long its adapter waits."""
    return list(_findings(port))


def _findings(port: str) -> Iterator[Finding]:
    yield _kind(port)
    if Path(port).exists():
        yield _permission(port)
        if not os.path.realpath(port).startswith(PSEUDO_TERMINALS):
            yield _users(port)
            yield _latency(port)


def _kind(port: str) -> Finding:
    real = os.path.realpath(port)
    known = next((each for each in comports() if os.path.realpath(each.device) == real), None)
    if known is not None and known.vid is not None:
        number = f", serial number {known.serial_number}" if known.serial_number else ""
        return Finding("adapter", f"{known.description} ({known.vid:04x}:{known.pid:04x}{number})")
    missing = not Path(port).exists()
    found = Finding("adapter", "there is none" if missing else f"no USB port: {real}", essential=True)
    return found.but(missing, f"there is no port {port}.", "plug its adapter in, or look at /dev/serial/by-id.")


def _permission(port: str) -> Finding:
    allowed = os.access(port, os.R_OK | os.W_OK)
    found = Finding("permission", "you may open it" if allowed else "refused", essential=True)
    cure = f"sudo usermod -aG {group_of(port)} $USER, and log in again."
    return found.but(not allowed, f"only root and the group {group_of(port)} may open {port}.", cure)


def _users(port: str) -> Finding:
    users = " and ".join(holders(port))
    found = Finding("in use by", users or "nobody")
    return found.but(users, "only one program at a time can talk on it.", "end that program first.")


def _latency(port: str) -> Finding:
    timer = latency_timer(port)
    if timer is None:
        return Finding("latency timer", "none")
    file = f"/sys/bus/usb-serial/devices/{Path(os.path.realpath(port)).name}/latency_timer"
    cure = f"echo 1 | sudo tee {file}; for good: echo '{UDEV_RULE}' | sudo tee {UDEV_FILE}, and plug it in again."
    problem = f"the adapter may hold each answer back for {timer} ms."
    return Finding("latency timer", f"{timer} ms").but(timer > 1, problem, cure)
