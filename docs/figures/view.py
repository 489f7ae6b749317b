"""Makes the pictures of the live view: run it from a folder with room for a run, and Chromium installed."""

from __future__ import annotations

import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "tests" / "view"))  # the page is driven as the tests drive it
from browser import Viewed, colours, viewed  # noqa: E402  # needs the line before

SETTLING = 20
CHOSEN = ("sample/arm/shoulder_position", "sample/arm/elbow_position")
LEFT_OUT = ("sample/joint/velocity",)


def main() -> None:
    """Write view_light.png, view_dark.png and view_zoomed.png beside this file."""
    with viewed() as (page, _):
        for name in (*CHOSEN, *LEFT_OUT):
            page.find(f"[name='{name}']").click()
        page.find("#plots").click()
        time.sleep(SETTLING)
        mark(page, "the arm was touched")
        time.sleep(6)  # until it no longer says so
        save(page, "view_light")
        colours(page.window, "dark")
        time.sleep(1)
        save(page, "view_dark")
        page.find("#pause").click()
        page.drag("[data-plot='unit rad'] .u-over", 0.55, 0.85)
        time.sleep(1)
        save(page, "view_zoomed")


def mark(page: Viewed, text: str) -> None:
    """Mark a moment, as a person would."""
    page.press("m")
    page.press(text, "\n")


def save(page: Viewed, name: str) -> None:
    """Save a picture of the page."""
    page.window.save_screenshot(str(HERE / f"{name}.png"))


if __name__ == "__main__":
    main()
