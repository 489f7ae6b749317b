"""The text of a scenario: its values, the line of every key, and what the command line set over it."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtagent.errors import ScenarioError

if TYPE_CHECKING:
    from tree_sitter import Node

KeyPath = tuple[str | int, ...]


class Source:
    """A parsed file. `overrides` are texts such as `schedule.period=10ms`, applied over it.

    Raises `ScenarioError` where the file cannot be read, is not TOML, or an override is not key=value.
    """

    def __init__(self, path: Path, overrides: Sequence[str] = ()) -> None:
        self.path = path
        self._text = _read(path)
        self._overridden: dict[KeyPath, str] = {}
        self._lines: dict[KeyPath, int] | None = None
        self.values = self._parse()
        problems = [problem for override in overrides if (problem := self._apply(override)) is not None]
        if problems:
            raise ScenarioError(problems)

    def where(self, path: KeyPath) -> str:
        """Return the place of a key, or of the nearest table around it: `file:line` or `--set key=value`."""
        lines = self._key_lines()
        for length in range(len(path), 0, -1):
            prefix = path[:length]
            if prefix in self._overridden:
                return f"--set {self._overridden[prefix]}"
            if prefix in lines:
                return f"{self.path}:{lines[prefix]}"
        return f"{self.path}:1"

    def _parse(self) -> dict[str, Any]:
        try:
            return tomllib.loads(self._text)
        except tomllib.TOMLDecodeError as error:
            raise ScenarioError(list(self._syntax_problems(str(error)))) from None

    def _syntax_problems(self, message: str) -> Iterator[str]:
        found = re.search(r"\(at line (\d+), column \d+\)", message)
        first = int(found[1]) if found else self._text.count("\n") + 1
        yield f"{self.path}:{first}: this is not TOML: {message}."
        lines = {node.start_point.row + 1 for node in _walk(self._root()) if node.is_error or node.is_missing}
        for line in sorted(line for line in lines if line > first):
            yield f"{self.path}:{line}: this is not TOML either."

    def _apply(self, override: str) -> str | None:
        key, equals, text = override.partition("=")
        names = tuple(name.strip() for name in key.split("."))
        if not equals or not all(names):
            return f"--set {override}: write it as key=value, such as --set run.seed=2."
        table: Any = self.values
        for name in names[:-1]:
            table = _inner(table, name)
            if table is None:
                return f"--set {override}: {name!r} is no table, nor a place in a list."
        if isinstance(table, list):
            return f"--set {override}: {names[-1]!r} is a place in a list: name a key of the table there."
        table[names[-1]] = _value(text)
        self._overridden[tuple(int(name) if name.isdigit() else name for name in names)] = override
        return None

    def _key_lines(self) -> dict[KeyPath, int]:
        if self._lines is None:
            self._lines = dict(_lines_of(self._root()))
        return self._lines

    def _root(self) -> Node:
        import tree_sitter
        import tree_sitter_toml

        parser = tree_sitter.Parser(tree_sitter.Language(tree_sitter_toml.language()))
        return parser.parse(self._text.encode()).root_node


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ScenarioError([f"{path}: there is no such file; scenarios/ holds examples."]) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError([f"{path}: the file cannot be read: {error}."]) from None


def _inner(table: Any, name: str) -> Any:
    """Return the table or list called `name` within another, or None where it is neither."""
    if isinstance(table, list):
        found = table[int(name)] if name.isdigit() and int(name) < len(table) else None
    else:
        found = table.setdefault(name, {})
    return found if isinstance(found, dict | list) else None


def _value(text: str) -> Any:
    """Return an override's value: what TOML makes of it, else the text itself."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _walk(node: Node) -> Iterator[Node]:
    yield node
    for child in node.children:
        yield from _walk(child)


def _lines_of(root: Node) -> Iterator[tuple[KeyPath, int]]:
    """Yield every key path with its line; the tables of an array of tables are numbered."""
    counts: dict[KeyPath, int] = {}
    for node in root.children:
        path: KeyPath = ()
        if node.type in ("table", "table_array_element"):
            path = _key(node.named_children[0])
            yield path, node.start_point.row + 1
        if node.type == "table_array_element":
            counts[path] = counts.get(path, -1) + 1
            path = (*path, counts[path])
        pairs = [node] if node.type == "pair" else node.named_children
        for pair in pairs:
            yield from _pair_lines(pair, path)


def _pair_lines(pair: Node, path: KeyPath) -> Iterator[tuple[KeyPath, int]]:
    if pair.type != "pair" or len(pair.named_children) < 2:
        return
    key, value = pair.named_children[0], pair.named_children[1]
    path += _key(key)
    yield path, pair.start_point.row + 1
    if value.type == "inline_table":
        for inner in value.named_children:
            yield from _pair_lines(inner, path)


def _key(node: Node) -> tuple[str, ...]:
    if node.type == "dotted_key":
        return tuple(name for child in node.named_children for name in _key(child))
    return ((node.text or b"").decode().strip("\"'"),)
