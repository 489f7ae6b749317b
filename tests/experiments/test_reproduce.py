"""`rtagent reproduce`: a report of all that was found, whatever fails, and nothing measured twice."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
import toys
from parts import ROOT
from toys import CALLED, toy

from rtagent import plugins
from rtagent.__main__ import main
from rtagent.experiments.experiment import Experiment, Options, Verdict
from rtagent.experiments.known import chosen, in_order
from rtagent.experiments.outcome import carry_out
from rtagent.experiments.report.page import About, page


@pytest.fixture(autouse=True)
def only_toys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have no experiments but those that a test knows."""
    monkeypatch.setattr(plugins, "_registered", {})
    installed = plugins._installed
    monkeypatch.setattr(plugins, "_installed", lambda group: {} if group == "experiments" else installed(group))
    CALLED.clear()
    known(toy("works"))


def known(experiment: Experiment) -> None:
    plugins._registered["experiments", experiment.name] = experiment  # type: ignore[assignment]  # no callable


def reproduced(folder: Path, *arguments: str) -> int:
    return main(["reproduce", *arguments, "--out", str(folder), "--jobs", "1"])


class Strict(HTMLParser):
    """Raises where tags do not close in order, and remembers the text and whatever would be fetched."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text, self.sources = "", list[str]()
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name == "src"]
        assert tag not in ("script", "link", "iframe", "object")
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_page_stands_alone_and_says_all(tmp_path: Path) -> None:
    assert reproduced(tmp_path, "works") == 0
    text = (tmp_path / "index.html").read_text()
    seen = Strict(text)
    for said in ("The toy works", "a <claim> & reproduced", "150", "Lines <of> ten series.", "a note", "Section 0"):
        assert said in seen.text
    for verdict in Verdict:
        assert verdict.value in seen.text
    assert "It models nothing." in seen.text
    assert "seeds 1 to 5" in seen.text
    assert seen.sources
    assert all(source.startswith("data:image/") for source in seen.sources)
    assert not re.search(r"url\(|@import|https?://", text.replace("data:image", ""))
    assert "prefers-color-scheme: dark" in text


def test_figures_are_files_too_and_claims_are_data(tmp_path: Path) -> None:
    reproduced(tmp_path, "works")
    assert (tmp_path / "figures" / "works-lines.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (tmp_path / "figures" / "works-lines.svg").read_bytes()
    claims = json.loads((tmp_path / "claims.json").read_text())["works"]["claims"]
    assert [claim["verdict"] for claim in claims] == [verdict.value for verdict in Verdict]


def test_the_same_data_give_the_same_figure(tmp_path: Path) -> None:
    figures = []
    for name in ("first", "second"):
        reproduced(tmp_path / name, "works")
        figures.append((tmp_path / name / "figures" / "works-lines.svg").read_bytes())
    assert figures[0] == figures[1]


def test_what_was_measured_is_not_measured_again(tmp_path: Path) -> None:
    reproduced(tmp_path, "works", "--quick")
    reproduced(tmp_path, "works")
    reproduced(tmp_path, "all")
    assert CALLED == [1, 2, 3, 4, 5]


def test_what_two_experiments_have_in_common_is_measured_and_planned_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known(toy("other", cells=lambda options: [{"seed": seed} for seed in range(4, 8)]))
    reproduced(tmp_path, "all")
    assert sorted(CALLED) == [1, 2, 3, 4, 5, 6, 7]
    assert "about 14 s" in capsys.readouterr().out


def test_an_experiment_that_fails_is_told_and_takes_no_other_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known(toy("fails", measure=toys.fail))
    known(toy("undrawable", find=toys.find_undrawable))
    assert reproduced(tmp_path, "all") == 1
    seen = Strict((tmp_path / "index.html").read_text())
    assert "5 of 5 could not be measured: RuntimeError: no <b>1</b> today" in seen.text
    assert "figure nothing: ZeroDivisionError: nothing to draw" in seen.text
    assert "a <claim> & reproduced" in seen.text
    told = capsys.readouterr()
    assert "fails failed: 5 of 5" in told.err
    assert "a <claim> & reproduced" in told.out


def test_the_list_tells_the_time_beforehand(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rtagent.commands.reproduce.processors", lambda: 2)
    known(toy("alone", alone=True, on_demand=True))
    assert main(["reproduce"]) == 0
    listed = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if "Section 0" in line}
    assert listed["works"].endswith("2 s      5 s    ")
    assert "4 s" in listed["alone"], "what is measured alone takes no advantage of two processors"
    assert "10 s" in listed["alone"]


def test_an_experiment_whose_cells_fail_or_that_is_none_hides_no_other(capsys: pytest.CaptureFixture[str]) -> None:
    def broken(options: Options) -> list[dict[str, int]]:
        raise OSError("no recording")

    known(toy("unlistable", cells=broken))
    plugins._registered["experiments", "nonsense"] = dict
    assert main(["reproduce"]) == 1
    told = capsys.readouterr()
    assert "'nonsense' of experiments is no Experiment" in told.err
    assert {line.split()[0] for line in told.out.splitlines() if "Section 0" in line} == {"unlistable", "works"}
    assert "unknown" in told.out


def test_experiments_stand_in_the_order_of_the_thesis() -> None:
    sections = [
        "Section 3.4.1",
        "Experiment 2 (3.4.2), figure 3.5",
        "sections 4.3 and 4.4",
        "Chapter 5",
        "Section 10.1",
        "none",
    ]
    shuffled = [replace(toy(thesis), thesis=thesis) for thesis in sections[::-1]]
    assert [each.thesis for each in in_order(shuffled)] == sections


def test_all_leaves_out_what_is_on_demand_and_a_name_does_not() -> None:
    known(toy("demanded", on_demand=True))
    assert [each.name for each in chosen(["all"])] == ["works"]
    assert [each.name for each in chosen(["demanded", "all"])] == ["works", "demanded"]
    assert [each.name for each in chosen(["demanded", "demanded"])] == ["demanded"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["wroks"], "there is no experiment 'wroks': did you mean 'works'?"),
        (["works", "--data", "nothing.csv"], "--data nothing.csv: there is no such file."),
        (["works", "--jobs", "0"], "--jobs 0: give 1 or more."),
        (["works", "--cluster", "there"], "write the scheduler's address as tcp://host:port"),
        (["works", "--out", "/dev/null/report"], "--out /dev/null/report: there can be no such folder"),
    ],
)
def test_a_bad_wish_has_a_sentence(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", *arguments]) == 2
    assert sentence in capsys.readouterr().err
    assert CALLED == []


def test_without_matplotlib_the_command_to_install_it_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("rtagent.commands.reproduce.find_spec", lambda name: None)
    assert main(["reproduce", "works"]) == 2
    assert "pip install 'rtagent[figures]'" in capsys.readouterr().err


def test_ctrl_c_leaves_a_report_of_what_was_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(cell: object) -> dict[str, int]:
        raise KeyboardInterrupt

    known(toy("zealous", measure=interrupted))
    assert reproduced(tmp_path, "works", "zealous") == 1
    assert "The toy works" in (tmp_path / "index.html").read_text()
    assert "the same command goes on" in capsys.readouterr().err


def test_a_large_figure_is_shown_as_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rtagent.experiments.report.page.LARGE", 10)
    measured = [toys.measure(cell) for cell in toys.cells(Options())]
    outcome = carry_out(toy("works"), Options(), lambda experiment, cells: measured, tmp_path)
    text = page([outcome], About("rtagent", "now", "1 s", "1", "one", quick=True))
    assert Strict(text).sources[0].startswith("data:image/png;base64,")


def test_the_experiment_of_the_page_works(tmp_path: Path) -> None:
    block = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "reproduce.md").read_text(), re.DOTALL)[0]
    names: dict[str, Any] = {}
    exec(compile(block, "reproduce.md", "exec"), names)  # noqa: S102  # our own page
    mine = names["EXPERIMENT"]
    outcome = carry_out(mine, Options(), lambda each, cells: [each.measure(cell) for cell in cells], tmp_path)
    assert not outcome.failures
    assert outcome.findings.claims[0].verdict == Verdict.NOT_REPRODUCED
