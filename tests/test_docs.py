"""What the documents show works, and what they name is there."""

from __future__ import annotations

import re
from typing import Any

import pytest
from parts import ROOT

from rtagent import plugins
from rtagent.testing import DeviceContract

CHECKS = [name for name in vars(DeviceContract) if name.startswith("test_")]


def blocks(document: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / document).read_text(), re.DOTALL)


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("clock", ["real", "virtual"])
def test_the_driver_of_the_page_on_drivers_keeps_the_contract(clock: str, check: str) -> None:
    names: dict[str, Any] = {}
    exec(compile(blocks("docs/drivers.md", "python")[0], "drivers.md", "exec"), names)  # noqa: S102  # our own page
    suite = DeviceContract()
    suite.clock = clock  # type: ignore[assignment]  # one of the two names
    suite.make_device = lambda: names["Thermometer"](port="/dev/ttyUSB0", interval=1_000_000)  # type: ignore[method-assign]
    getattr(suite, check)()


@pytest.mark.parametrize("group", ["drivers", "tasks", "features", "learners", "policies"])
def test_every_plugin_and_its_settings_are_on_the_page_on_scenarios(group: str) -> None:
    page = (ROOT / "docs" / "scenarios.md").read_text()
    for name in plugins.names(group):
        plugin = plugins.load(group, name)
        if not plugin.__module__.startswith("rtagent"):
            continue
        assert f"`{name}`" in page, f"{group} {name} is not described"
        for setting in plugins.settings(plugin):
            assert re.search(rf"`{setting}\b|`[^`]*\b{setting}\b[^`]*`", page), f"{name}.{setting} is not described"


def test_links_between_documents_lead_somewhere() -> None:
    for document in [ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\((?!http)([^)#]+)", document.read_text()):
            assert (document.parent / target).exists(), f"{document.name} links to {target}"
