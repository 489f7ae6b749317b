"""The sender: a process that makes records of what the loop wrote, encodes them once, and hands the bytes on.

It outlives a run that is killed, for as long as it takes to send and record what the run had written.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import select
import signal
import sys
from typing import TYPE_CHECKING, Any

import msgspec

from rtagent.clock import RealClock
from rtagent.telemetry import records
from rtagent.telemetry.connection import Access, TelemetryError
from rtagent.telemetry.keys import Place
from rtagent.telemetry.lull import Lull, Pace
from rtagent.telemetry.manners import give_way
from rtagent.telemetry.publishing import Publisher
from rtagent.telemetry.records import STREAM_OF, Record
from rtagent.telemetry.ring import Ring
from rtagent.telemetry.unpacking import Unpacker
from rtagent.units import second

if TYPE_CHECKING:
    from rtagent.telemetry.recording import Recorder

ORDERS, ANSWERS = 0, 1
PAUSE = 0.01
"""How long (s) it rests where there is nothing to send: nobody has to wake it."""
AT_ONCE = 200
"""So many messages are sent before it looks at anything else."""
LITTLE, BREATH = 1 << 17, 0.0005
"""Where fewer bytes wait, it sends in lulls of the loop, or rests (s) after each message where it knows none."""
OPENING = 2.0
"""How long (s) what comes first waits for Zenoh."""
CLOSING = 0.3
"""How long (s) Zenoh may take to close."""
WRITING_OUT = 60.0
"""How long (s) the recorder may take to write out what waits."""


class Order(msgspec.Struct, frozen=True):
    """What a run tells its sender at the start; `publish` None: nothing is published; `record` "": nothing kept."""

    ring: int
    size: int
    place: tuple[str, str]
    about: dict[str, Any]
    publish: Access | None
    record: str
    control: bool
    commands: list[str]
    pace: Pace


class Sender:
    """Sends what the ring of a run holds."""

    def __init__(self, order: Order) -> None:
        self._ring = Ring(order.ring, order.size)
        self._about = order.about
        self._unpack = Unpacker(order.about["actions"])
        self._encode = msgspec.json.Encoder().encode
        self._commands = order.commands
        self._lull = Lull(order.pace)
        self._given: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
        self._recorder = self._open_recorder(order.record)
        self._publisher = self._open_publisher(order)
        self._epoch, self._virtual = order.about["epoch_ns"], order.about["clock"] == "virtual"
        self._next_count = 0
        self._emit(self._run())

    def _open_recorder(self, path: str) -> Recorder | None:
        if not path:
            return None
        try:
            from rtagent.telemetry.recording import Recorder

            return Recorder(path, _trouble)
        except OSError as error:
            _trouble(f"nothing is recorded: {path}: {error.strerror}. Give another file.")
        except ImportError:
            _trouble("nothing is recorded: recordings need the package mcap: pip install mcap.")
        return None

    def _open_publisher(self, order: Order) -> Publisher | None:
        if order.publish is None:
            return None
        publisher = Publisher(
            order.publish, Place(*order.place), self._command if order.control else None, _trouble
        )
        publisher.start(OPENING)
        return publisher

    def work(self) -> None:
        """Send until the run has ended and all that it wrote is sent."""
        running = True
        while running:
            running = not select.select([ORDERS], [], [], self._send())[0]
            self._look()
        while self._send_some(AT_ONCE):
            self._look()

    def end(self) -> None:
        """Tell what is missing, close the session, and end the recording."""
        self._emit(self._counters())
        if self._publisher is not None:
            self._publisher.close(CLOSING)
        _tell(closed=self._recorder is None or self._recorder.close(WRITING_OUT))

    def _send(self) -> float:
        """Send what may be sent now; return how long (s) to rest then."""
        if self._ring.filled >= LITTLE:
            self._send_some(AT_ONCE)
            return 0.0
        began = RealClock.now()
        if wait := self._lull.until(began):
            return wait / second
        if not self._send_some(1):
            return PAUSE
        now = RealClock.now()
        self._lull.took(now - began)
        return self._lull.until(now) / second if self._lull.known else BREATH

    def _send_some(self, most: int) -> bool:
        """Send so many of the messages that wait; say whether there was one."""
        for sent in range(most):
            message = self._ring.read()
            if message is None:
                return sent > 0
            self._emit(*self._unpack(message, self._lull.heard))
            if self._unpack.run_changed:
                self._emit(self._run())
        return True

    def _emit(self, *made: Record) -> None:
        """Publish and record; Zenoh is given all at once, so that router and listeners wake but once for them."""
        encoded = [(STREAM_OF[type(record)], record, self._encode(record)) for record in made]
        if self._publisher is not None:
            for stream, _, data in encoded:
                self._publisher.put(stream, data)
        if self._recorder is not None:
            for stream, record, data in encoded:
                self._recorder.add(stream, record.sequence, self._epoch + record.time_ns, data)

    def _look(self) -> None:
        """Do what is due: take commands, tell counts."""
        while not self._given.empty():
            name, text = self._given.get()
            self._emit(self._unpack.make(records.Event, self._now(), name=name, text=text))
        if RealClock.now() >= self._next_count:
            self._next_count = RealClock.now() + second
            self._emit(self._counters())
            if self._recorder is not None:
                self._recorder.look()

    def _now(self) -> int:
        """Return the time of the run's clock, or under the virtual one of its newest record."""
        return self._unpack.time if self._virtual else RealClock.now()

    def _run(self) -> Record:
        unpack = self._unpack
        unpack.run_changed = False
        return unpack.make(
            records.Run, self._about["began_ns"], demons=unpack.demons, ended=unpack.ended, **_without(self._about)
        )

    def _counters(self) -> Record:
        lost = {f"lost.{stream}": count for stream, count in self._unpack.lost.items()}
        missing = {} if self._recorder is None else {"not_recorded": self._recorder.not_recorded}
        values = self._unpack.counts | lost | missing | {"buffered": self._ring.filled}
        return self._unpack.make(records.Counters, self._now(), values=values)

    def _command(self, name: str, text: str) -> str:
        """Take a command of a viewer's, in a thread of Zenoh's."""
        if name not in self._commands:
            raise TelemetryError(f"there is no command {name!r}: this run takes {', '.join(self._commands)}.")
        if name == "press" and text not in self._about["buttons"]:
            raise TelemetryError(
                f"there is no button {text!r}: {', '.join(self._about['buttons']) or 'this run has none'}."
            )
        self._given.put(("annotation" if name == "annotate" else name, text))
        if name != "annotate":
            _tell(command=name, text=text)
        return "done"


def _without(about: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in about.items() if name != "began_ns"}


def _trouble(sentence: str) -> None:
    _tell(trouble=sentence)


def _tell(**answer: Any) -> None:
    """Send a line to the run, if there is still one."""
    with contextlib.suppress(OSError):
        os.write(ANSWERS, json.dumps(answer).encode() + b"\n")


def main() -> None:
    """Send for the run that started this process."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    give_way()
    length = int.from_bytes(os.read(ORDERS, 8), "little")
    order = msgspec.json.decode(_read(length), type=Order)
    try:
        sender = Sender(order)
        sender.work()
        sender.end()
    except Exception as error:
        _trouble(f"telemetry ended: {error!r}. The run goes on without it.")
        raise
    sys.stdout.close()
    os._exit(0)  # whatever threads of Zenoh's or a stalled disk still hold


def _read(length: int) -> bytes:
    data = b""
    while len(data) < length:
        part = os.read(ORDERS, length - len(data))
        if not part:
            raise SystemExit(1)
        data += part
    return data


if __name__ == "__main__":
    main()
