"""Memory is claimed before it is taken; what is too much is refused with a sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
from parts import SCENARIOS

from rtagent import memory
from rtagent.__main__ import main
from rtagent.errors import SpecError

PREDICT = str(SCENARIOS / "predict.toml")


@pytest.fixture
def of_a_gigabyte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the machine one with 1 GB free."""
    info = tmp_path / "meminfo"
    info.write_text("MemTotal:  4000000 kB\nMemAvailable:  976563 kB\n")
    monkeypatch.setattr(memory, "MEMORY_INFO", info)


@pytest.mark.usefixtures("of_a_gigabyte")
def test_what_fits_is_summed_up_and_what_does_not_is_refused() -> None:
    with memory.ledger() as claims:
        memory.claim(300_000_000, "weights")
        memory.claim(200_000_000, "prototypes")
        memory.claim(200_000_000, "weights")
        with pytest.raises(SpecError, match=r"400 MB for traces, after 700 MB for the rest is more than the 1 GB"):
            memory.claim(400_000_000, "traces")
    assert claims == {"weights": 500_000_000, "prototypes": 200_000_000}
    memory.claim(900_000_000, "what comes after the ledger")


def test_a_machine_that_does_not_say_refuses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "MEMORY_INFO", tmp_path / "nowhere")
    memory.claim(10**18, "everything")


@pytest.mark.parametrize(
    ("size", "text"), [(0, "0 B"), (999, "999 B"), (4_812_345_678, "4.81 GB"), (12 * 10**12, "12 TB")]
)
def test_sizes_are_written_with_their_unit(size: int, text: str) -> None:
    assert memory.describe_size(size) == text


def test_check_says_what_an_agent_takes(capsys: pytest.CaptureFixture[str]) -> None:
    sets = ["--set", "features.prototypes=1000", "--set", "learner.demons.0.bins=49"]
    assert main(["check", PREDICT, *sets]) == 0
    said = capsys.readouterr().out
    assert "8 MB for the weights of 2,000 demons over 1,000 features" in said
    assert "memory of an agent: " in said


@pytest.mark.usefixtures("of_a_gigabyte")
@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("features.prototypes", "100_000_000", "features: 16 GB for prototypes is more than the 1 GB"),
        ("learner.demons.0.bins", "9_999", "learner: 3.2 GB for the weights of 400,000 demons over 2,000 features"),
        ("run.trials", "100_000", "run.trials: the agents of 100000 trials take"),
    ],
)
@pytest.mark.slow
def test_check_refuses_what_the_machine_does_not_have(
    key: str, value: str, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", PREDICT, "--set", f"{key}={value}"]) == 2
    assert sentence in capsys.readouterr().err
