"""What is typed, from the bytes of a terminal: keys by their names, with releases where the terminal tells them.

Terminals that speak the keyboard protocol of kitty ("Comprehensive keyboard handling in terminals", its
documentation) report presses, repeats and releases; others send a byte for each press and each repeat.
"""

from __future__ import annotations

import codecs
import re
from typing import Final, Literal, NamedTuple

ASK: Final = b"\x1b[?u"
"""A terminal that speaks the protocol answers."""

BEGIN: Final = b"\x1b[>11u"
"""Report every key as a sequence, with repeats and releases (1 + 2 + 8)."""

END: Final = b"\x1b[<u"

NAMES: Final = {9: "tab", 10: "enter", 13: "enter", 27: "escape", 32: "space", 8: "backspace", 127: "backspace"}
CONTROL: Final = 4
LONGEST: Final = 64
"""A sequence that is longer is none."""

_SEQUENCE = re.compile(r"\x1b\[([?<>=]?)([0-9;:]*)([@-~])")
_BEGUN = re.compile(r"\x1b\[[?<>=]?[0-9;:]*$")

Kind = Literal["press", "repeat", "release"]
_KINDS: Final[dict[str, Kind]] = {"1": "press", "2": "repeat", "3": "release"}


class Key(NamedTuple):
    """A key: a character ("b"), "space", "enter", …, perhaps with Ctrl held.

    `told`: by a terminal that tells of releases too.
    """

    name: str
    kind: Kind = "press"
    control: bool = False
    told: bool = False


class Keys:
    """Makes keys of bytes as they come. `speaks` turns true when the terminal has answered `ASK`."""

    def __init__(self) -> None:
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._rest = ""
        self.speaks = False

    def feed(self, data: bytes) -> list[Key]:
        """Return the keys of some bytes; what is not complete is kept for the next."""
        text, self._rest = self._rest + self._decoder.decode(data), ""
        keys: list[Key] = []
        place = 0
        while place < len(text):
            found = _SEQUENCE.match(text, place)
            if found is not None:
                keys += self._of_sequence(*found.groups())
                place = found.end()
            elif _BEGUN.match(text, place) and len(text) - place < LONGEST:
                self._rest, place = text[place:], len(text)
            else:
                keys.append(_of_character(text[place]))
                place += 1
        return keys

    def _of_sequence(self, mark: str, numbers: str, last: str) -> list[Key]:
        if mark == "?" and last == "u":
            self.speaks = True
            return []
        if mark or last != "u":
            return []  # an arrow, or an answer to somebody else
        code, _, rest = numbers.partition(";")
        modifiers, _, event = rest.partition(";")[0].partition(":")
        number = int(code.partition(":")[0] or 0)
        held = int(modifiers or 1) - 1
        name = NAMES.get(number) or (chr(number).lower() if 32 < number < 0xD800 else "")
        return [Key(name, _KINDS.get(event or "1", "press"), bool(held & CONTROL), told=True)]


def _of_character(character: str) -> Key:
    number = ord(character)
    if number in NAMES:
        return Key(NAMES[number])
    if number < 32:
        return Key(chr(number + 96), control=True)
    return Key(character.lower())
