"""The layers of the house: each imports only downwards, and time is asked for in one place."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import rtagent
import rtagent_drivers

PACKAGE = Path(rtagent.__file__).parent
DRIVERS = Path(rtagent_drivers.__file__).parent

LAYERS = [
    {"errors", "units", "specs", "experience", "schedule", "ordering", "streams", "saving", "memory", "learn"},
    {"features", "learning", "kernels", "policy"},
    {
        "device", "events", "task", "tasks", "clock", "realtime", "costs", "pacing", "reaction",
        "series", "summary", "recorder", "instruments", "guard", "latch", "health",
        "latched", "living", "watchdog",
    },
    {
        "agent", "backlog", "checkpoint", "urgency", "guard", "supervision", "senses", "idling", "runtime",
        "orderer", "situation", "result", "keeping", "lifecycle", "shutdown", "protection",
    },
]  # fmt: skip
EDGES = len(LAYERS)
"""Whatever is in no other layer is an edge."""

TIME_FUNCTIONS = {"time", "sleep", "monotonic", "perf_counter", "time_ns", "monotonic_ns", "perf_counter_ns"}
MODULES = sorted(PACKAGE.rglob("*.py"))


def layer(module: str) -> int:
    """Return the layer of a module by its dotted name, such as rtagent.clock.real."""
    top = module.removeprefix("rtagent").removeprefix(".").split(".")[0]
    return next((number for number, names in enumerate(LAYERS) if top in names), EDGES)


def name_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def is_for_types_only(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")


def imports(tree: ast.AST, *, with_types: bool = True) -> Iterator[str]:
    """Yield the dotted names of all that is imported, wherever in the module."""
    for node in ast.iter_child_nodes(tree):
        if is_for_types_only(node) and not with_types:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            yield from (_imported(node.module or "", alias.name) for alias in node.names)
        else:
            yield from imports(node, with_types=with_types)


def _imported(module: str, name: str) -> str:
    """Return the module that `from module import name` reads."""
    place = PACKAGE.parent.joinpath(*module.split("."), name)
    is_module = module.startswith("rtagent") and (place.is_dir() or place.with_suffix(".py").exists())
    return f"{module}.{name}" if is_module else module


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_module_imports_only_from_its_own_layer_and_those_below(path: Path) -> None:
    own = name_of(path)
    upwards = {
        name
        for name in imports(parse(path), with_types=own != "rtagent")
        if name.split(".")[0] == "rtagent" and layer(name) > layer(own)
    }
    assert upwards == set()


def test_no_modules_import_each_other_in_a_circle() -> None:
    known = {name_of(path): path for path in MODULES}
    graph = {
        name: {other for other in imports(parse(path), with_types=False) if other in known and other != name}
        for name, path in known.items()
    }
    try:
        order = list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(f"a circle of imports: {error.args[1]}")
    assert len(order) == len(known)


def test_every_layer_is_there() -> None:
    found = {name_of(path).split(".")[1] for path in MODULES if name_of(path) != "rtagent"}
    assert set().union(*LAYERS) - found == set()


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_the_runtime_imports_no_driver(path: Path) -> None:
    assert not [name for name in imports(parse(path)) if name.split(".")[0] == "rtagent_drivers"]


@pytest.mark.parametrize("path", [path for path in MODULES if layer(name_of(path)) < 2], ids=name_of)
def test_what_is_pure_or_numeric_knows_no_event_loop(path: Path) -> None:
    assert not [name for name in imports(parse(path)) if name.split(".")[0] == "asyncio"]


def time_calls(tree: ast.AST) -> Iterator[str]:
    """Yield every use of a function of the module time, by whatever name it goes."""
    modules, functions = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules |= {alias.asname or alias.name for alias in node.names if alias.name == "time"}
        elif isinstance(node, ast.ImportFrom) and node.module == "time":
            functions |= {alias.asname or alias.name for alias in node.names if alias.name in TIME_FUNCTIONS}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in TIME_FUNCTIONS:
            if isinstance(node.value, ast.Name) and node.value.id in modules:
                yield ast.unparse(node)
        elif isinstance(node, ast.Name) and node.id in functions:
            yield node.id


@pytest.mark.parametrize("path", [*MODULES, *sorted(DRIVERS.rglob("*.py"))], ids=lambda path: path.stem)
def test_only_the_clock_asks_the_machine_for_the_time(path: Path) -> None:
    if PACKAGE / "clock" not in path.parents and path.name != "last_resort.py":  # it has no loop to ask
        assert list(time_calls(parse(path))) == []


def test_the_clock_is_found_to_ask_the_machine_for_the_time() -> None:
    assert list(time_calls(parse(PACKAGE / "clock" / "real.py")))
    assert list(time_calls(ast.parse("from time import monotonic as m\nprint(m())")))
    assert not list(time_calls(ast.parse("import time\nclock.time()")))


def test_imports_are_found_wherever_they_are() -> None:
    source = """
from typing import TYPE_CHECKING
from rtagent import clock, ms
if TYPE_CHECKING:
    from rtagent.runtime import Runtime
def late():
    import rtagent.agent
"""
    found = set(imports(ast.parse(source)))
    assert found == {"typing", "rtagent.clock", "rtagent", "rtagent.runtime", "rtagent.agent"}
    assert "rtagent.runtime" not in set(imports(ast.parse(source), with_types=False))


@pytest.mark.parametrize(("name", "number"), [("rtagent.units", 0), ("rtagent.clock.real", 2), ("rtagent", EDGES)])
def test_a_module_belongs_to_the_layer_of_its_package(name: str, number: int) -> None:
    assert layer(name) == number
