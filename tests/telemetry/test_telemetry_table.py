"""`[telemetry]` of a scenario: what is open to others is closed to strangers, or refused."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from parts import SCENARIOS

from rtagent.__main__ import main
from rtagent.errors import ScenarioError
from rtagent.scenario import load
from rtagent.telemetry import wishes
from rtagent.telemetry.connection import Access, TelemetryError, open_client
from rtagent.telemetry.keys import Place, as_chunk, place_of
from rtagent.telemetry.wishes import access_of

STOPPING = SCENARIOS / "stopping.toml"
CLOSED = ("telemetry.users=u", "telemetry.certificate=c", "telemetry.key=k")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["telemetry.endpoint=127.0.0.1:7447"], "is no endpoint"),
        (["telemetry.listen=['tls/0.0.0.0']"], "is no endpoint"),
        (["telemetry.listen=['tls/0.0.0.0:7448']"], "give users, certificate and key"),
        (["telemetry.listen=['tcp/0.0.0.0:7448']", *CLOSED], "in the clear"),
        (["telemetry.endpoint=tcp/robot.example:7447"], "in the clear"),
        (["telemetry.buffer=0"], "greater than or equal to 1"),
    ],
)
def test_what_would_be_open_is_refused(settings: list[str], said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        load(STOPPING, settings)


def test_what_is_closed_to_strangers_is_taken() -> None:
    table = load(STOPPING, ["telemetry.listen=['tls/0.0.0.0:7448']", *CLOSED]).model.telemetry
    assert access_of(table) == Access(listen=("tls/0.0.0.0:7448",), users="u", certificate="c", key="k")
    assert not table.control


@pytest.mark.parametrize("settings", [["run.clock=virtual"], ["telemetry.enabled=false"]])
def test_a_run_that_is_neither_published_nor_recorded_has_no_sender(
    settings: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not load(STOPPING, settings).model.published
    monkeypatch.setattr(wishes, "open_telemetry", pytest.fail)
    options = ["run.clock=virtual", "run.episodes=1", *settings]
    assert main(["run", str(STOPPING), "--quiet", *(part for each in options for part in ("--set", each))]) == 0


def test_where_a_package_is_missing_the_run_goes_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for name in [name for name in sys.modules if name.startswith("rtagent.telemetry")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "msgspec", None)
    options = ["--clock", "virtual", "--quiet", "--episodes", "1", "--record", str(tmp_path / "run.mcap")]
    assert main(["run", str(STOPPING), *options]) == 0
    assert "pip install msgspec" in capsys.readouterr().err
    assert not (tmp_path / "run.mcap").exists()


def test_a_place_is_found_again_in_its_keys() -> None:
    place = Place(as_chunk("an arm/at the *window*"), "today")
    assert place.agent == "an-arm-at-the-window"
    assert place_of(place.key("sample")) == place
    assert not place.control("stop").startswith("rtagent/")


def test_where_nothing_listens_elsewhere_that_is_said() -> None:
    with pytest.raises(TelemetryError, match=r"nothing listens at tls/127\.0\.0\.1:1:"):
        open_client(Access(endpoint="tls/127.0.0.1:1"))


def test_a_password_that_is_not_there_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--user", "lab", "--password-file", str(tmp_path / "absent"), "--endpoint", "tls/127.0.0.1:1"]
    assert main(["watch", "--once", *options]) == 2
    assert "nothing listens" in capsys.readouterr().err


def test_record_needs_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(STOPPING), "--record", str(tmp_path / "absent" / "run.mcap")]) == 2
    assert "a folder that exists" in capsys.readouterr().err
