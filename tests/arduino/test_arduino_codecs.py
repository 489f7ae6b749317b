"""What boards say, whole and damaged: our frames, and the lines and words of older sketches."""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Sequence
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtagent.units import ms, us
from rtagent_drivers.arduino import frames, legacy
from rtagent_drivers.arduino.cobs import stuffed, unstuffed
from rtagent_drivers.arduino.layouts import LAYOUTS
from rtagent_drivers.arduino.messages import Hello, Message, Scan, ServoState

READINGS = st.integers(0, 1023)
SCANS = st.builds(
    Scan, st.lists(READINGS, max_size=16).map(tuple), st.integers(0, 2**16 - 1), st.integers(0, 2**32 - 1)
)
HELLO = Hello(1, True, 1333 * us, 488 * us, 306 * us, 200 * ms, True, ("2", "A0", "A15"), (3, 11))
GOOD: dict[str, tuple[bytes, Scan]] = {
    "rtagent": (frames.scan((0, 1023, 46), 7, 99), Scan((0, 1023, 46), 7, 99)),
    "handi": (legacy.line(range(1, 17), ",").replace(b"1,", b"0,", 1), Scan((0, *range(2, 17)))),
    "glovi": (legacy.line((1, 2, 3, 4, 5, 1023), ", "), Scan((1, 2, 3, 4, 5, 1023))),
    "glovi_binary": (legacy.words((5, 46, 1, 46, 0, 1023)), Scan((5, 46, 1, 46, 0, 1023))),
}


def in_pieces(data: bytes, rng: Random) -> list[bytes]:
    pieces = []
    while data:
        size = rng.randint(1, 40)
        pieces.append(data[:size])
        data = data[size:]
    return pieces


def fed(name: str, *pieces: bytes) -> list[Message]:
    decoder = LAYOUTS[name].decoder()  # type: ignore[index]  # one of the names
    return [message for piece in pieces for message in decoder.feed(piece)]


# Stuffing: the examples of the paper's later expositions, and its definition, byte by byte


def reference(data: bytes) -> bytes:
    out, run = bytearray(), bytearray()
    for at, byte in enumerate(data):
        if byte:
            run.append(byte)
        if not byte or len(run) == 254:
            ends_here = byte and at == len(data) - 1
            out += bytes([len(run) + 1]) + run
            run = bytearray()
            if ends_here:
                return bytes(out)
    return bytes(out + bytes([len(run) + 1]) + run)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ("00", "01 01"),
        ("00 00", "01 01 01"),
        ("11 22 00 33", "03 11 22 02 33"),
        ("11 22 33 44", "05 11 22 33 44"),
        ("11 00 00 00", "02 11 01 01 01"),
        ("01" * 254, "FF" + "01" * 254),
        ("00" + "01" * 254, "01 FF" + "01" * 254),
        ("01" * 255, "FF" + "01" * 254 + "02 01"),
        ("01" * 254 + "00", "FF" + "01" * 254 + "01 01"),
    ],
)
def test_bytes_are_stuffed_as_published(data: str, expected: str) -> None:
    assert stuffed(bytes.fromhex(data)).hex() == bytes.fromhex(expected).hex()
    assert unstuffed(bytes.fromhex(expected)) == bytes.fromhex(data)


@given(st.one_of(st.binary(max_size=600), st.lists(st.sampled_from([0, 1]), max_size=600).map(bytes)))
def test_what_is_stuffed_has_no_zero_and_comes_back(data: bytes) -> None:
    assert stuffed(data) == reference(data)
    assert 0 not in stuffed(data)
    assert unstuffed(stuffed(data)) == data


# Our frames


def test_a_frame_is_as_the_sketch_makes_it() -> None:
    assert crc_hqx(b"123456789", 0xFFFF) == 0x29B1, "the check of CRC-16/CCITT-FALSE"
    assert bytes([4, ord("s"), *crc_hqx(b"s", 0xFFFF).to_bytes(2, "little"), 0]) == frames.MAKE_SAFE
    recorded = "02 53 01 03 f2 28 01 01 01 01 01 01 01 03 09 03 01 01 01 03 07 8d 00"  # of a sketch under simavr
    assert fed("rtagent", b"\0", bytes.fromhex(recorded)) == [Scan((0, 0, 0, 777, 0, 0), 0, 10482)]


@given(st.lists(SCANS, max_size=5), st.integers(0, 2**32))
def test_messages_come_back_however_the_bytes_are_cut(scans: Sequence[Scan], seed: int) -> None:
    state = ServoState(2, 3, (0, 1500, 2400))
    said = [*scans, HELLO, state]
    data = b"\0" + b"".join(frames.scan(*scan) for scan in scans) + frames.hello(HELLO) + frames.servo_state(state)  # type: ignore[arg-type]
    assert fed("rtagent", *in_pieces(data, Random(seed))) == said


@given(SCANS, st.data())
def test_no_damage_of_a_frame_goes_unseen(scan: Scan, data: st.DataObject) -> None:
    whole = bytearray(frames.scan(*scan))  # type: ignore[arg-type]
    at = data.draw(st.integers(0, len(whole) - 2))
    whole[at] = data.draw(st.integers(1, 255).filter(lambda byte: byte != whole[at]))
    decoder = frames.FrameDecoder()
    decoder.feed(b"\0")
    assert decoder.feed(bytes(whole)) == []
    assert decoder.bad == 1


def test_a_hello_of_another_version_is_known_for_that() -> None:
    other = frames.frame(b"H", b"\x07whatever it says")
    assert fed("rtagent", b"\0" + other) == [Hello(7)]


# All formats


@pytest.mark.parametrize("name", GOOD)
@pytest.mark.parametrize("seed", range(3))
def test_random_bytes_raise_nothing_and_the_next_good_message_is_found(name: str, seed: int) -> None:
    rng, decoder = Random(seed), LAYOUTS[name].decoder()  # type: ignore[index]
    good, scan = GOOD[name]
    alphabets = [None, b"0123456789,\r\n", legacy.HEADER + b"\x00\x01\xff"]
    for _ in range(60):
        for _ in range(rng.randrange(8)):
            letters = rng.choice(alphabets)
            noise = rng.randbytes(200) if letters is None else bytes(rng.choices(letters, k=200))
            for piece in in_pieces(noise, rng):
                decoder.feed(piece)
        decoder.feed(good)  # ends whatever was begun
        decoder.feed(good)
        assert scan in decoder.feed(good)


@pytest.mark.parametrize("name", GOOD)
def test_what_begins_in_the_middle_is_left_out_and_not_counted(name: str) -> None:
    decoder = LAYOUTS[name].decoder()  # type: ignore[index]
    good, scan = GOOD[name]
    for begin in range(1, len(good)):
        decoder = LAYOUTS[name].decoder()  # type: ignore[index]
        found = [*decoder.feed(good[begin:]), *decoder.feed(good), *decoder.feed(good), *decoder.feed(good)]
        assert found[-1] == scan
        assert set(found) == {scan}, f"cut at {begin}"
        assert decoder.bad == 0


# Older sketches


@pytest.mark.parametrize(
    "line",
    [
        "0,1,2,3,4,5,6,7,8,9,10,11,12,13,14",
        "0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16",
        "0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,15",
        "0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,1024",
        "2,1,2,3,4,5,6,7,8,9,10,11,12,13,14,15",
        "0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,",
        "0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,-5",
        "0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,1_0",
        "0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,\u00b2",
        "",
    ],
)
def test_lines_that_are_cut_glued_or_of_another_count_are_counted_and_dropped(line: str) -> None:
    decoder = LAYOUTS["handi"].decoder()
    good, scan = GOOD["handi"]
    assert decoder.feed(b"\r\n" + good + line.encode() + b"\r\n" + good) == [scan, scan]
    assert decoder.bad == 1


def test_a_header_among_the_numbers_misleads_nobody_for_long() -> None:
    rng, decoder = Random(1), legacy.WordDecoder()
    scans = [tuple(rng.choice((46, 46, 46, rng.randrange(1024))) for _ in range(6)) for _ in range(300)]
    found = decoder.feed(b"".join(map(legacy.words, scans))[7:])
    assert found[-250:] == [Scan(scan) for scan in scans[-250:]]


def test_a_number_that_no_converter_reads_is_counted_and_dropped() -> None:
    decoder, frame = legacy.WordDecoder(), legacy.words((1, 2, 3, 4, 5, 6))
    assert len(decoder.feed(frame * 3)) == 3, "in step"
    assert decoder.feed(frame[:8] + b"\xff" + frame[9:] + frame * 3)[-2:] == [Scan((1, 2, 3, 4, 5, 6))] * 2
    assert decoder.bad == 1
