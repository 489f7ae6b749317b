"""What the tests measure: functions of a module, as other processes want them, that tell who called them."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

Cell = Mapping[str, Any]


def squared(cell: Cell) -> dict[str, Any]:
    """Note that it was asked, in a file if the cell names one, and return the square."""
    if "asked" in cell:
        with Path(cell["asked"]).open("a") as file:
            file.write(f"{cell['number']} {os.getpid()}\n")
    time.sleep(cell.get("takes", 0.0))
    return {"square": cell["number"] ** 2}


def choosy(cell: Cell) -> dict[str, Any]:
    if cell["number"] % 3 == 2:
        raise ValueError(f"{cell['number']} is not for me")
    return squared(cell)


def not_plain(cell: Cell) -> dict[str, Any]:
    return {"array": np.zeros(2)}


def deadly(cell: Cell) -> dict[str, Any]:
    if cell["number"] == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return squared(cell)


def threads(cell: Cell) -> dict[str, Any]:
    """Return the most threads that any library here would take."""
    import threadpoolctl

    np.dot(np.ones((8, 8)), np.ones((8, 8)))
    return {"most": max((pool["num_threads"] for pool in threadpoolctl.threadpool_info()), default=1)}


def asked(path: Path) -> list[int]:
    """Return the numbers that were asked for, in order."""
    return [int(line.split()[0]) for line in path.read_text().splitlines()] if path.exists() else []


def main() -> None:
    """Compute the squares of COUNT numbers, each of which takes SECONDS, in a process that a test can kill."""
    from rtagent.sweeps.compute import compute

    folder, count, seconds, jobs = Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
    cells = [{"number": number, "takes": seconds, "asked": str(folder / "asked")} for number in range(count)]
    compute(squared, cells, store=folder / "store", jobs=jobs)


if __name__ == "__main__":
    sys.modules["measuring"] = sys.modules["__main__"]
    squared.__module__ = "measuring"
    main()
