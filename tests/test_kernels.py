"""Kernels are loaded where they are wanted, kept between runs, and done without where there is no compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from parts import ROOT, SCENARIOS

from rtagent import kernels

WITHOUT_NUMBA = """
import sys, warnings
sys.modules["numba"] = None
warnings.simplefilter("always")
from rtagent.__main__ import main
sys.exit(main(sys.argv[1:]))
"""
SMALL = (
    "devices.arm.arm.duration=20s", "features.prototypes=100", "learner.demons.0.gammas=[0.8, 0.9]",
    "learner.precision=float64",
)  # fmt: skip


def python(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, env=os.environ | environment
    )


@pytest.mark.slow
def test_without_a_compiler_a_run_is_the_same_but_for_rounding_after_one_warning() -> None:
    arguments = ["run", str(SCENARIOS / "predict.toml"), "--json", "-", "--quiet"]
    arguments += [part for setting in SMALL for part in ("--set", setting)]
    plain = python(WITHOUT_NUMBA, *arguments)
    assert plain.returncode == 0, plain.stderr
    assert plain.stderr.count("pip install numba") == 1
    compiled = python("import sys; from rtagent.__main__ import main; sys.exit(main(sys.argv[1:]))", *arguments)
    assert compiled.stderr == ""
    assert numbers(plain.stdout) == pytest.approx(numbers(compiled.stdout), rel=1e-9)


def numbers(printed: str) -> list[float]:
    import json

    (trial,) = json.loads(printed)["trials"]
    return [errors["mae"] for errors in trial["predictions"].values()]


@pytest.mark.slow
def test_what_was_compiled_is_kept(tmp_path: Path) -> None:
    code = "from rtagent import kernels; kernels.load('linear')"
    settings = {"NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_DEBUG_CACHE": "1"}
    first, second = (python(code, **settings).stdout for _ in range(2))
    assert "data saved to" in first
    assert "data loaded from" in second
    assert "data saved to" not in second


def test_what_takes_long_is_told(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    import time

    monkeypatch.setattr(kernels, "SILENCE", 0.01)
    monkeypatch.setattr(kernels.importlib, "import_module", lambda name: time.sleep(0.2))
    kernels.load("linear")
    assert "getting the kernels for linear ready" in capsys.readouterr().err
    monkeypatch.setattr(kernels, "SILENCE", 60.0)
    kernels.load("linear")
    assert capsys.readouterr().err == ""


def test_within_plain_nothing_is_loaded() -> None:
    with kernels.plain(), kernels.plain():
        assert kernels.load("linear") is None
    assert kernels.load("linear") is not None


@pytest.mark.slow
def test_no_kernel_holds_the_interpreter() -> None:
    """The main thread counts on while another one is in a kernel for long."""
    code = """
import threading, time
import numpy as np
from rtagent import kernels
k = kernels.load("shared_trace")
weights, vector = np.zeros((4, 2_000_000)), np.zeros(2_000_000)
rows, ones = np.zeros(100, np.int64), np.ones(100)
counted, done = 0, False
def work():
    global done
    k.add_to_rows(weights, vector, rows, ones, 0, 2_000_000)
    done = True
thread = threading.Thread(target=work)
thread.start()
while not done:
    counted += 1
    time.sleep(0)
print(counted)
"""
    assert int(python(code).stdout) > 10
