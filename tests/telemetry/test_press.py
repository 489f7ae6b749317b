"""A button that is pressed by somebody who watches."""

from __future__ import annotations

from pathlib import Path

from rtagent.device import Pressable
from rtagent_drivers.button.driver import Button


async def test_a_press_by_a_viewer_is_seen_and_is_a_stimulus(tmp_path: Path) -> None:
    button = Button(source="unix", path=str(tmp_path / "button"))
    assert isinstance(button, Pressable)
    button.press()  # before it is open nobody presses
    await button.open()
    try:
        before = await button.read(-1)
        button.press()
        after = await button.read(before.sequence)
        assert (before.values["pressed"], after.values["pressed"]) == (False, True)
        assert len(button.stimuli(before.arrival_time, after.arrival_time)) == 1
        assert not (await button.read(after.sequence)).values["pressed"]
    finally:
        await button.close()
