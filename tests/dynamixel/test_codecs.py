"""The codecs: the manuals' own examples, round trips, streams of anything."""

from __future__ import annotations

from itertools import pairwise
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent.errors import SpecError
from rtagent_drivers.dynamixel import timing
from rtagent_drivers.dynamixel.codecs import CODECS, codec
from rtagent_drivers.dynamixel.packets import BROADCAST, Instruction, Request, Span, Status, Write
from rtagent_drivers.dynamixel.protocol1 import PROTOCOL1
from rtagent_drivers.dynamixel.protocol2 import PROTOCOL2, combined, split_fast

MANUAL_1 = [
    (Request(1, Instruction.PING), "FF FF 01 02 01 FB"),
    (PROTOCOL1.read(Span(1, 43, 1)), "FF FF 01 04 02 2B 01 CC"),
    (PROTOCOL1.write(Write(BROADCAST, 3, b"\x01")), "FF FF FE 04 03 03 01 F6"),
    (PROTOCOL1.write(Write(1, 30, b"\xf4\x01"), registered=True), "FF FF 01 05 04 1E F4 01 E2"),
    (Request(BROADCAST, Instruction.ACTION), "FF FF FE 02 05 FA"),
    (Request(0, Instruction.FACTORY_RESET), "FF FF 00 02 06 F7"),
    (
        PROTOCOL1.sync_write(30, {0: bytes.fromhex("10005001"), 1: bytes.fromhex("20026003")}),
        "FF FF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67",
    ),
    (PROTOCOL1.group_read([Span(1, 30, 2), Span(2, 36, 2)]), "FF FF FE 09 92 00 02 01 1E 02 02 24 1D"),
]
MANUAL_2 = [
    (Request(1, Instruction.PING), "FF FF FD 00 01 03 00 01 19 4E"),
    (Request(BROADCAST, Instruction.PING), "FF FF FD 00 FE 03 00 01 31 42"),
    (PROTOCOL2.read(Span(1, 132, 4)), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    (PROTOCOL2.write(Write(1, 116, b"\x00\x02\x00\x00")), "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"),
    (
        PROTOCOL2.write(Write(1, 104, b"\xc8\x00\x00\x00"), registered=True),
        "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E",
    ),
    (Request(1, Instruction.ACTION), "FF FF FD 00 01 03 00 05 02 CE"),
    (Request(1, Instruction.FACTORY_RESET, b"\x01"), "FF FF FD 00 01 04 00 06 01 A1 E6"),
    (Request(1, Instruction.REBOOT), "FF FF FD 00 01 03 00 08 2F 4E"),
    (Request(1, Instruction.CLEAR, b"\x01DXL\x22"), "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC"),
    (
        PROTOCOL2.group_read([Span(1, 144, 2), Span(2, 146, 1)]),
        "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
    ),
    (
        PROTOCOL2.bulk_write([Write(1, 32, b"\xa0\x00"), Write(2, 31, b"\x50")]),
        "FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68",
    ),
    (
        PROTOCOL2.fast_sync_read([Span(3, 132, 4), Span(7, 132, 4), Span(4, 132, 4)]),
        "FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2",
    ),
]
ANSWERS_1 = [
    (Status(1, 0), "FF FF 01 02 00 FC"),
    (Status(1, 0x24), "FF FF 01 02 24 D8"),
    (Status(1, 0, b"\x20"), "FF FF 01 03 00 20 DB"),
    (Status(2, 0, b"\x00\x80"), "FF FF 02 04 00 00 80 79"),
]
ANSWERS_2 = [
    (Status(1, 0, b"\x06\x04\x26"), "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
    (Status(2, 0, b"\x06\x04\x26"), "FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D"),
    (Status(1, 0, b"\xa6\x00\x00\x00"), "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
    (Status(1, 0), "FF FF FD 00 01 04 00 55 00 A1 0C"),
    (Status(2, 0, b"\x24"), "FF FF FD 00 02 05 00 55 00 24 8B A9"),
]


@pytest.mark.parametrize(
    ("protocol", "request_", "expected"),
    [(1, *example) for example in MANUAL_1] + [(2, *example) for example in MANUAL_2],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_requests_are_those_of_the_manual(protocol: int, request_: Request, expected: str) -> None:
    assert CODECS[protocol].request(request_) == bytes.fromhex(expected)
    assert CODECS[protocol].request_decoder().feed(bytes.fromhex(expected)) == [request_]


@pytest.mark.parametrize(
    ("protocol", "status", "expected"),
    [(1, *example) for example in ANSWERS_1] + [(2, *example) for example in ANSWERS_2],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_answers_are_those_of_the_manual(protocol: int, status: Status, expected: str) -> None:
    assert CODECS[protocol].status(status) == bytes.fromhex(expected)
    assert CODECS[protocol].status_decoder().feed(bytes.fromhex(expected)) == [status]


def test_the_combined_answer_is_that_of_the_manual() -> None:
    """Each servo's CRC covers all that came before it in the packet."""
    values = {3: "A6000000", 7: "1F080000", 4: "FF030000"}
    answers = [Status(servo, 0, bytes.fromhex(value)) for servo, value in values.items()]
    sent = PROTOCOL2.status(combined(answers))
    beginning = "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00"
    assert sent[:-2] == bytes.fromhex(beginning)
    spans = [Span(servo, 132, 4) for servo in values]
    assert split_fast(PROTOCOL2.status_decoder().feed(sent)[0], spans) == answers


def test_a_combined_answer_is_believed_up_to_the_first_servo_that_is_wrong() -> None:
    answers = [Status(servo, 0, bytes(4)) for servo in (1, 2, 3)]
    spans = [Span(servo, 132, 4) for servo in (1, 2, 3)]
    one = combined(answers)
    damaged = Status(one.servo, one.error, one.parameters[:9] + b"\x01" + one.parameters[10:])
    assert split_fast(damaged, spans) == answers[:1]
    assert split_fast(one, [spans[0], spans[2]]) == answers[:1]
    assert split_fast(Status(BROADCAST, 0), spans) == []


servos = st.integers(0, 252)
contents = st.one_of(
    st.binary(max_size=200),
    st.lists(st.sampled_from([b"\xff", b"\xff\xff", b"\xfd", b"\x00", b"\xff\xff\xfd", b"\x55"]), max_size=60).map(
        b"".join
    ),
)
requests = st.builds(
    Request,
    st.one_of(servos, st.just(BROADCAST)),
    st.sampled_from(sorted(set(Instruction) - {Instruction.STATUS})).map(int),
    contents,
)
answers = st.builds(Status, servos, st.integers(0, 0x7F), contents)
protocols = st.sampled_from([1, 2])


@given(protocols, st.lists(requests, max_size=5), st.lists(answers, max_size=5), st.data())
@settings(max_examples=60)
def test_what_is_sent_is_what_is_found_however_it_is_cut(
    protocol: int, sent: list[Request], answered: list[Status], data: st.DataObject
) -> None:
    its = CODECS[protocol]
    for decoder, packets, stream in (
        (its.request_decoder(), sent, b"".join(map(its.request, sent))),
        (its.status_decoder(), answered, b"".join(map(its.status, answered))),
    ):
        cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=6).map(sorted))
        found = [packet for a, b in pairwise([0, *cuts, len(stream)]) for packet in decoder.feed(stream[a:b])]
        assert found == packets
        assert (decoder.damaged, decoder.skipped, decoder.reset()) == (0, 0, [])


@given(protocols, st.binary(max_size=300), answers, st.integers(1, 40))
@settings(max_examples=100)
def test_cutting_a_stream_of_anything_changes_nothing(
    protocol: int, noise: bytes, answer: Status, size: int
) -> None:
    its = CODECS[protocol]
    stream = noise + its.status(answer) + noise[::-1]
    whole, piecewise = its.status_decoder(), its.status_decoder()
    expected = [*whole.feed(stream), *whole.reset()]
    found = [p for at in range(0, len(stream), size) for p in piecewise.feed(stream[at : at + size])]
    assert [*found, *piecewise.reset()] == expected
    assert (piecewise.damaged, piecewise.skipped) == (whole.damaged, whole.skipped)


@pytest.mark.parametrize("protocol", [1, 2])
def test_noise_is_survived_and_the_next_packet_found(protocol: int) -> None:
    """Bytes that look like headers, lengths and half packets; every byte ends in a packet or is counted."""
    rng, its = Random(protocol), CODECS[protocol]
    decoder, good = its.status_decoder(), Status(17, 0, b"\x01\x02\xff\xff\xfd\x03")
    pieces = (b"\xff", b"\xff\xff", b"\xff\xff\xfd\x00", b"\xfd", its.status(good)[:9], its.status(good)[5:])
    total = taken = 0
    for _ in range(400):
        noise = b"".join(rng.choice((*pieces, rng.randbytes(3))) for _ in range(rng.randrange(8)))
        found = [*decoder.feed(noise), *decoder.reset(), *decoder.feed(its.status(good))]
        assert found[-1:] == [good]
        total += len(noise) + len(its.status(good))
        taken += sum(len(its.status(packet)) for packet in found)
    assert decoder.damaged > 100
    assert decoder.skipped == total - taken


@pytest.mark.parametrize("protocol", [1, 2])
def test_a_packet_that_was_cut_short_costs_only_itself(protocol: int) -> None:
    its, decoder = CODECS[protocol], CODECS[protocol].status_decoder()
    first, second, third = (Status(servo, 0, bytes(8)) for servo in (1, 2, 3))
    stream = its.status(first)[:-3] + its.status(second) + its.status(third)
    assert [*decoder.feed(stream), *decoder.reset()] == [second, third]
    assert decoder.damaged == 1


def test_a_false_beginning_holds_nothing_back_for_ever() -> None:
    """In protocol 1.0 it may claim 255 bytes; the deadline ends that, and what stood behind it is not lost."""
    decoder, answer = PROTOCOL1.status_decoder(), Status(5, 0, bytes(8))
    assert decoder.feed(b"\xff\xff\x01\xff\x00" + PROTOCOL1.status(answer)) == []
    assert decoder.reset() == [answer]


@pytest.mark.parametrize(("protocol", "false"), [(1, "FF FF 01 FF 00"), (2, "FF FF FD 00 FE 00 04 55 00 01")])
def test_noise_that_claims_to_be_longer_than_what_is_expected_holds_up_nothing(protocol: int, false: str) -> None:
    its, decoder = CODECS[protocol], CODECS[protocol].status_decoder()
    answer = Status(5, 0, bytes(8))
    decoder.longest = its.status_length(8)
    assert decoder.feed(bytes.fromhex(false) + its.status(answer)) == [answer]
    assert decoder.feed(its.status(Status(5, 0, bytes(9)))) == []


def test_a_header_within_a_broken_packet_of_protocol_2_is_a_new_packet_at_once() -> None:
    decoder, answer = PROTOCOL2.status_decoder(), Status(5, 0, bytes(8))
    cut = PROTOCOL2.status(Status(1, 0, bytes(100)))[:50]
    assert decoder.feed(cut + PROTOCOL2.status(answer)) == [answer]
    assert decoder.damaged == 1


def test_answers_and_requests_of_protocol_2_are_told_apart() -> None:
    request, answer = Request(1, Instruction.PING), Status(1, 0, b"\x01")
    stream = PROTOCOL2.request(request) + PROTOCOL2.status(answer)
    assert PROTOCOL2.status_decoder().feed(stream) == [answer]
    assert PROTOCOL2.request_decoder().feed(stream) == [request]


@pytest.mark.parametrize("protocol", [1, 2])
def test_what_is_asked_can_be_read_from_the_request(protocol: int) -> None:
    its = CODECS[protocol]
    spans = [Span(1, 36, 8), Span(2, 40, 2)]
    writes = [Write(3, 30, b"\x01\x02"), Write(4, 30, b"\xff\xff")]
    assert its.spans(its.group_read(spans)) == spans
    assert its.spans(its.read(spans[0])) == spans[:1]
    assert its.writes(its.sync_write(30, {write.servo: write.data for write in writes})) == writes
    assert its.writes(its.write(writes[0], registered=True)) == writes[:1]
    assert its.spans(its.write(writes[0])) == its.writes(its.read(spans[0])) == []


def test_what_is_asked_of_protocol_2_in_groups_can_be_read_from_the_request() -> None:
    alike = [Span(1, 126, 21), Span(2, 126, 21)]
    mixed = [Span(1, 126, 21), Span(2, 132, 4)]
    writes = [Write(1, 116, b"\x01\x02\x03\x04"), Write(2, 64, b"\x01")]
    for spans, ask in (
        (alike, PROTOCOL2.sync_read),
        (alike, PROTOCOL2.fast_sync_read),
        (mixed, PROTOCOL2.group_read),
        (mixed, PROTOCOL2.fast_bulk_read),
    ):
        assert PROTOCOL2.spans(ask(spans)) == spans
    assert PROTOCOL2.writes(PROTOCOL2.bulk_write(writes)) == writes


def test_one_servo_alone_is_not_read_in_bulk_by_protocol_1() -> None:
    """The manual: bulk read "cannot be used to read a single module"."""
    assert PROTOCOL1.group_read([Span(1, 36, 8)]) == PROTOCOL1.read(Span(1, 36, 8))


@pytest.mark.parametrize("protocol", [1, 2])
@pytest.mark.parametrize("instruction", [i for i in Instruction if i & 0x80 or i in (2, 3, 4)])
def test_parameters_that_end_too_early_have_a_sentence(protocol: int, instruction: int) -> None:
    its = CODECS[protocol]
    for length in range(12):
        request = Request(BROADCAST, instruction, bytes((1, 2, 4, 0, 3, 1, 4, 0, 9, 9, 9, 9))[:length])
        for read in (its.spans, its.writes):
            try:
                read(request)
            except SpecError as error:
                assert str(error).endswith(".")  # noqa: PT017 (it need not be raised for every length)


@pytest.mark.parametrize(
    ("protocol", "wrong"),
    [
        (1, lambda its: its.request(Request(300, 1))),
        (1, lambda its: its.request(Request(1, 1, bytes(254)))),
        (1, lambda its: its.read(Span(1, 256, 1))),
        (1, lambda its: its.status(Status(1, 256))),
        (2, lambda its: its.request(Request(253, 1))),
        (2, lambda its: its.request(Request(1, 1, bytes(1022)))),
        (2, lambda its: its.request(Request(1, 1, b"\xff\xff\xfd" * 300))),
        (2, lambda its: its.read(Span(1, -1, 1))),
        (2, lambda its: its.fast_sync_read([Span(1, 1, 1), Span(2, 1, 2)])),
        (2, lambda its: its.group_read([Span(1, 1, 1), Span(1, 1, 1)])),
        (2, lambda its: its.sync_write(1, {1: b"1", 2: b"22"})),
        (2, lambda its: its.sync_write(1, {})),
        (1, lambda its: its.group_read([])),
    ],
)
def test_what_no_packet_can_say_has_a_sentence(protocol: int, wrong) -> None:
    with pytest.raises(SpecError, match=r"\.$"):
        wrong(CODECS[protocol])


def test_there_are_two_protocols() -> None:
    assert codec(1) is PROTOCOL1
    with pytest.raises(SpecError, match="speak 1 or 2"):
        codec(3)


@pytest.mark.parametrize(
    ("protocol", "span", "baud", "fast", "delayed"),
    [
        (1, (36, 8), 57_600, 16.0, 18.5),
        (1, (36, 8), 1_000_000, 0.92, 3.42),
        (1, (36, 8), 4_000_000, 0.23, 2.73),
        (2, (126, 21), 57_600, 31.1, 33.6),
        (2, (126, 21), 1_000_000, 1.79, 4.29),
        (2, (126, 21), 4_000_000, 0.45, 2.95),
    ],
)
def test_bus_times_are_those_counted_by_hand(
    protocol: int, span: tuple[int, int], baud: int, fast: float, delayed: float
) -> None:
    """Milliseconds for five servos, without and with the return delay from the factory (500 µs)."""
    its = CODECS[protocol]
    request = its.request(its.group_read([Span(servo, *span) for servo in range(1, 6)]))
    replies = [its.status_length(span[1])] * 5
    for delay, expected in ((0, fast), (500_000, delayed)):
        took = timing.transaction(len(request), replies, baud, delay) / 1e6
        assert took == pytest.approx(expected, abs=0.05 if expected > 5 else 0.006)


def test_bus_time_of_a_fast_read_has_one_delay() -> None:
    spans = [Span(servo, 126, 21) for servo in range(1, 6)]
    request = PROTOCOL2.request(PROTOCOL2.fast_sync_read(spans))
    reply = PROTOCOL2.status(combined([Status(span.servo, 0, bytes(21)) for span in spans]))
    assert timing.transaction(len(request), [len(reply)], 1_000_000, 0) == 1_520_000
    assert timing.transaction(len(request), [len(reply)], 1_000_000, 500_000) == 2_020_000
