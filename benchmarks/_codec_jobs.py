"""The codecs: what five servos' packets cost beside their time on the wire, and a million bytes of noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from random import Random
from time import perf_counter

import dynamixel_sdk as sdk
from _harness import Row

from rtagent_drivers.dynamixel.codecs import CODECS
from rtagent_drivers.dynamixel.packets import Codec, Decoder, Request, Span, Status
from rtagent_drivers.dynamixel.timing import transaction

SPANS = {1: (36, 8), 2: (126, 21)}
SERVOS = range(1, 6)
BAUD = 1_000_000
NOISE = 1_000_000
GOOD_EVERY = 10_000
RUNS, CALLS = 7, 300
PIECES = (b"\xff", b"\xff\xff", b"\xff\xff\xfd\x00", b"\xfd", b"\x55", b"\x01\x04")


def costs() -> Iterator[Row]:
    """Yield what encoding a group read and decoding its five answers cost, and their share of the bus's time."""
    for protocol, codec in CODECS.items():
        spans = [Span(servo, *SPANS[protocol]) for servo in SERVOS]
        replies = [codec.status(Status(servo, 0, bytes(range(SPANS[protocol][1])))) for servo in SERVOS]
        decoder, stream = codec.status_decoder(), b"".join(replies)
        encoding = best(lambda codec=codec, spans=spans: codec.request(codec.group_read(spans)))
        decoding = best(lambda decoder=decoder, stream=stream: decoder.feed(stream))
        yield Row(f"{protocol}.0: encoding a group read of 5 servos", encoding * 1e6, "µs")
        yield Row(f"{protocol}.0: decoding its answers in one piece", decoding * 1e6, "µs")
        piecewise = best(lambda decoder=decoder, replies=replies: [decoder.feed(reply) for reply in replies])
        yield Row(f"{protocol}.0: decoding them one by one", piecewise * 1e6, "µs")
        request = codec.request(codec.group_read(spans))
        on_the_wire = transaction(len(request), map(len, replies), BAUD, 0) / 1e9
        share = (encoding + decoding) / on_the_wire
        yield Row(f"{protocol}.0: both, of the bus's time at 1 Mbaud", share * 100, "%", reach=5)
        theirs = best(lambda protocol=protocol, replies=replies: _decoded_by_sdk(protocol, replies))
        yield Row(f"{protocol}.0: decoding, times as fast as the SDK", theirs / decoding, "", 1, "higher")


def noise() -> Iterator[Row]:
    """Yield how a million random bytes, with a good packet now and then, are borne by each decoder."""
    for protocol, codec in CODECS.items():
        answer, request = Status(17, 0, b"\xff\xff\xfd\x00\x01"), Request(17, 3, b"\xff\xff\xfd\x00\x01")
        lost = _lost(codec, codec.status_decoder(), codec.status(answer), answer)
        lost += _lost(codec, codec.request_decoder(), codec.request(request), request)
        packets = 2 * NOISE // GOOD_EVERY
        yield Row(f"{protocol}.0: good packets lost of {packets} amid 2 · 10⁶ bytes of noise", lost, "", reach=0)


def best(work: Callable[[], object]) -> float:
    """Return how long `work` takes (s), in the quickest of several runs."""
    times = []
    for _ in range(RUNS):
        start = perf_counter()
        for _ in range(CALLS):
            work()
        times.append((perf_counter() - start) / CALLS)
    return min(times)


def _lost(codec: Codec, decoder: Decoder[object], good: bytes, expected: object) -> int:
    """Return how many good packets were not found: each comes after noise, and after the deadline that ends it."""
    rng, lost = Random(codec.protocol), 0  # noqa: S311  # nothing secret is drawn
    for _ in range(NOISE // GOOD_EVERY):
        decoder.feed(_noise(rng))
        decoder.reset()
        lost += expected not in decoder.feed(good)
    return lost


def _noise(rng: Random) -> bytes:
    pieces: list[bytes] = []
    size = 0
    while size < GOOD_EVERY:
        pieces.append(rng.choice(PIECES) if rng.random() < 0.3 else rng.randbytes(rng.randrange(40)))
        size += len(pieces[-1])
    return b"".join(pieces)


class _Port:
    """What the SDK reads answers from."""

    def __init__(self, data: bytes) -> None:
        self.is_using, self._data = False, data

    def readPort(self, length: int) -> bytes:  # noqa: N802 (the SDK's name)
        taken, self._data = self._data[:length], self._data[length:]
        return taken

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return not self._data


def _decoded_by_sdk(protocol: int, replies: Sequence[bytes]) -> None:
    handler, port = sdk.PacketHandler(float(protocol)), _Port(b"".join(replies))
    for servo in SERVOS:
        handler.readRx(port, servo, SPANS[protocol][1])
