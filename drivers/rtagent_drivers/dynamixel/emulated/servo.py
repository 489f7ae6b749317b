"""One servo: its control table, what is written into it, and what it does to its joint."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from rtagent.errors import SpecError
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.units import ms
from rtagent_drivers.dynamixel import values
from rtagent_drivers.dynamixel.emulated.drives import beyond_limits, drive, mode
from rtagent_drivers.dynamixel.emulated.memory import Memory, Refusal
from rtagent_drivers.dynamixel.emulated.robots import Joint
from rtagent_drivers.dynamixel.models import by_name
from rtagent_drivers.dynamixel.physics import Motion, State
from rtagent_drivers.dynamixel.steps import LIMP, Drive, Hand

VOLTAGE_ERROR, OVERHEATED, OVERLOADED = 0x01, 0x04, 0x20
"""Bits of the errors of protocol 1.0, and of the register hardware_error of 2.0."""

TOLERANCE = 0.03
"""By so much may a host's baud rate differ from the servo's (57,600 is 57,142 in protocol 1.0)."""

ALERT = 0x80
WATCHDOG_UNIT = 20 * ms
STOPPED_BY_WATCHDOG = -1
REBOOTING = 150 * ms
"""A servo that starts anew hears nothing for so long."""

GOALS = frozenset({"goal_position", "goal_velocity", "goal_torque", "goal_pwm"})
LOGGED = ("torque_enable", "torque_limit", "bus_watchdog", "operating_mode", *sorted(GOALS))

KEPT = ("_latched", "_live", "_heard_at", "_deaf_until")
"""What is saved of a servo as it is."""

Tell = Callable[[int, "Servo", str, Any], None]
"""Takes what happened to a servo: when (ns), to which, what, and the value."""


class Servo:
    """A servo and its joint; times are in ns and never go back."""

    def __init__(self, joint: Joint, now: int, supply: Callable[[int], float], tell: Tell) -> None:
        self.joint, self.model = joint, by_name(joint.model)
        self.memory = Memory(self.model)
        self.motion = Motion(joint.body, joint.start, now)
        self._supply, self._tell = supply, tell
        self._drive: Drive = LIMP
        self._registered: tuple[int, bytes] | None = None
        self._latched = self._live = 0
        self._heard_at = now
        self._deaf_until = now
        self.memory["id"] = joint.id
        self.memory["baud_rate"] = _baud_count(self.model.protocol, joint.baud)
        self.memory.set_si("return_delay", joint.return_delay / 1e9)
        self.memory.set_si("goal_position", joint.start)

    @property
    def id(self) -> int:
        """The id that it answers to."""
        return self.memory["id"]

    @property
    def baud(self) -> int:
        """Bit/s at which it listens and answers."""
        return values.baud_rate(self.model.protocol, self.memory["baud_rate"])

    @property
    def return_delay(self) -> int:
        """How long (ns) it waits before it answers."""
        return round(self.memory.si("return_delay") * 1e9)

    def hears(self, now: int, baud: int) -> bool:
        """Return whether it understands what comes at `baud`: not while it starts anew."""
        return now >= self._deaf_until and abs(baud - self.baud) <= TOLERANCE * self.baud

    def error(self, refusal: Refusal | None = None) -> int:
        """Return the error byte of an answer."""
        bits = self._latched | self._live
        if self.model.protocol == 1:
            return bits | (refusal.value[0] if refusal else 0)
        return (ALERT if bits else 0) | (refusal.value[1] if refusal else 0)

    def due(self) -> int | None:
        """Return when (ns) something happens to it by itself: its watchdog stops it, or it lets go."""
        times = (self._watchdog_due(), self._lets_go())
        return min((time for time in times if time is not None), default=None)

    def advance(self, now: int) -> None:
        """Let happen what happens by itself until `now`."""
        while (due := self.due()) is not None and due <= now:
            if due == self._lets_go():
                self._fail(due, OVERLOADED)
            else:
                self._stop_by_watchdog(due)

    def heard(self, now: int) -> None:
        """Take note of a packet on the bus."""
        self._heard_at = now

    def read(self, now: int, address: int, length: int) -> bytes | None:
        """Return a stretch of its control table as it is at `now`; None where there is none."""
        self._measure(now)
        return self.memory.read(address, length)

    def write(self, now: int, address: int, data: bytes) -> Refusal | None:
        """Write to its control table; return why that is refused, if it is."""
        refusal = self._refuses(address, data)
        if refusal is None:
            self.memory.write(address, data)
            self._obey(now, self.memory.touched(address, len(data)))
        return refusal

    def register(self, address: int, data: bytes) -> Refusal | None:
        """Keep what is to be written when ACTION comes."""
        refusal = self._refuses(address, data)
        if refusal is None:
            self._registered = address, data
            self.memory["registered"] = 1
        return refusal

    def act(self, now: int) -> Refusal | None:
        """Write what was registered."""
        if self._registered is None:
            return Refusal.INSTRUCTION
        (address, data), self._registered = self._registered, None
        self.memory["registered"] = 0
        return self.write(now, address, data)

    def reboot(self, now: int) -> None:
        """Start anew, limp and without errors; it hears nothing meanwhile."""
        self._latched, self._registered = 0, None
        self._deaf_until = now + REBOOTING
        self.memory.reset(eeprom=False)
        self.memory.set_si("goal_position", self.motion.at(now).position)
        self._tell(now, self, "reboot", True)
        self._follow(now)

    def factory_reset(self, now: int, keep: Iterable[str]) -> None:
        """Be as from the factory, but for the registers to `keep`."""
        self.memory.reset(eeprom=True, keep=tuple(keep))
        self.reboot(now)

    def suffer(self, now: int, kind: str, *, begins: bool) -> None:
        """Have a fault begin or end that concerns the servo itself."""
        if kind == "blocked":
            self.motion.block(now, begins)
        elif kind == "overload":
            if begins:
                self._fail(now, OVERLOADED)
        elif kind in CONDITIONS:
            self._live = self._live | CONDITIONS[kind] if begins else self._live & ~CONDITIONS[kind]
            if begins:
                self._fail(now, CONDITIONS[kind])

    def move(self, now: int, position: float | None) -> bool:
        """Be moved to `position` (rad) by a hand, or be let go (None); False where the servo holds against it."""
        if self._drive != LIMP:
            return False
        self.motion.drive(now, LIMP if position is None else Hand(position))
        return True

    def place(self, now: int, position: float) -> None:
        """Be at `position` (rad) at once, limp and at rest."""
        self.memory["torque_enable"] = 0
        self._drive = LIMP
        self.motion = Motion(self.joint.body, position, now)

    def save(self) -> Saved:
        """Return its control table, its motion and its errors; of what came over a line nothing is kept."""
        return {"memory": self.memory.save(), "motion": self.motion.save()} | save_fields(self, KEPT)

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        self.memory.restore(saved["memory"])
        restore_fields(self, KEPT, saved)
        self._drive = drive(self.memory, self.model)
        self.motion.restore(saved["motion"], self._drive)

    def state(self, now: int) -> State:
        """Return the true state of the joint."""
        return self.motion.at(now)

    def _refuses(self, address: int, data: bytes) -> Refusal | None:
        refusal = self.memory.refuses(address, data, locked=bool(self.memory["torque_enable"]))
        if refusal is not None:
            return refusal
        touched = self.memory.touched(address, len(data)).keys()
        if self.memory.get("bus_watchdog") == STOPPED_BY_WATCHDOG and touched & GOALS:
            return Refusal.RANGE
        if self.model.protocol == 2 and self._latched and "torque_enable" in touched:
            return Refusal.RANGE if data[self._offset("torque_enable", address)] else None
        return Refusal.LIMIT if self._breaks_limits(address, data, touched) else None

    def _offset(self, name: str, address: int) -> int:
        return self.model.registers[name].address - address

    def _breaks_limits(self, address: int, data: bytes, touched: Iterable[str]) -> bool:
        before = self.memory.read(address, len(data))
        assert before is not None, "what is too long was refused"
        self.memory.write(address, data)
        broken = any(beyond_limits(self.memory, name, self.model.protocol) for name in touched)
        self.memory.write(address, before)
        return broken

    def _obey(self, now: int, touched: Iterable[str]) -> None:
        names = set(touched)
        if self.model.protocol == 1:
            if "goal_position" in names and mode(self.memory) == "position":
                self._switch_on(now)
            if "torque_limit" in names and self.memory["torque_limit"]:
                self._latched = 0
        for name in LOGGED:
            if name in names:
                self._tell(now, self, name, self.memory.si(name) if name in GOALS else self.memory[name])
        self._follow(now)

    def _switch_on(self, now: int) -> None:
        """Switch torque on by itself: in protocol 1.0 a goal does that."""
        if not self.memory["torque_enable"]:
            self.memory["torque_enable"] = 1
            self._tell(now, self, "torque_enable", 1)

    def _follow(self, now: int) -> None:
        """Do what the control table says now."""
        wanted = drive(self.memory, self.model)
        if wanted != self._drive:
            self._drive = wanted
            self.motion.drive(now, wanted)

    def _fail(self, now: int, bit: int) -> None:
        """Have an error: it stays, and switches torque off where the register shutdown says so."""
        if self.model.protocol == 2 or bit == OVERLOADED:
            self._latched |= bit
        if bit & self.memory["shutdown"]:
            name = "torque_limit" if self.model.protocol == 1 else "torque_enable"
            self.memory[name] = 0
            self._tell(now, self, name, 0)
        self._tell(now, self, "error", bit)
        self._follow(now)

    def _lets_go(self) -> int | None:
        return None if self._drive == LIMP else self.motion.lets_go()

    def _watchdog_due(self) -> int | None:
        count = self.memory.get("bus_watchdog")
        return self._heard_at + count * WATCHDOG_UNIT if count > 0 and self.memory["torque_enable"] else None

    def _stop_by_watchdog(self, now: int) -> None:
        position = self.motion.at(now).position
        for name, value in (("goal_position", position), ("goal_velocity", 0.0), ("goal_torque", 0.0)):
            self.memory.set_si(name, value)
        self.memory["bus_watchdog"] = STOPPED_BY_WATCHDOG
        self._tell(now, self, "bus_watchdog", STOPPED_BY_WATCHDOG)
        self._follow(now)

    def _measure(self, now: int) -> None:
        """Bring the registers of what is measured up to date."""
        state, memory = self.motion.at(now), self.memory
        temperature = state.temperature if not self._live & OVERHEATED else memory["temperature_limit"] + 5.0
        if temperature >= memory["temperature_limit"] and not self._latched & OVERHEATED:
            self._fail(now, OVERHEATED)
        memory.set_si("present_position", self._angle(state.position))
        memory.set_si("present_velocity", state.velocity)
        memory.set_si("present_load", state.load)
        memory.set_si("present_temperature", temperature)
        memory.set_si("present_voltage", self._supply(now) * (0.4 if self._live & VOLTAGE_ERROR else 1.0))
        memory["moving"] = int(abs(state.velocity) > 0.02)
        memory.set_si("realtime_tick", now // ms % 32768 / 1000)
        if "hardware_error" in memory:
            memory["hardware_error"] = self._latched | self._live

    def _angle(self, position: float) -> float:
        """Return what it reads of an angle: protocol 1.0 counts a wheel's turns from nothing each time."""
        register = self.model.registers["present_position"]
        if self.model.protocol == 2 or mode(self.memory) != "wheel":
            return position
        count = round(position / register.scale) + register.zero
        return values.to_si(register, count % self.model.counts_per_turn)


CONDITIONS = {"overheat": OVERHEATED, "voltage": VOLTAGE_ERROR}
"""Faults that last, by the error that they make."""


def _baud_count(protocol: int, baud: int) -> int:
    """Return what the register baud_rate says for a baud rate; raise `SpecError` where a servo has none like it."""
    counts = range(255) if protocol == 1 else range(len(values.BAUDS_2))
    nearest = min(counts, key=lambda count: abs(values.baud_rate(protocol, count) - baud))
    if abs(values.baud_rate(protocol, nearest) - baud) > TOLERANCE * baud:
        raise SpecError(f"servos of protocol {protocol}.0 do not have {baud} baud: give another, such as 1Mbaud.")
    return nearest
