"""YAML with the position of every key and value, so that a configuration error can say file:line:column."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from posegaussian.storage.model.documents import shortened
from posegaussian.storage.model.errors import ConfigError, SourceError
from posegaussian.storage.model.yaml_documents import Loader, compose

Location = tuple[str | int, ...]


def parse_value(text: str) -> Any:
    """One value as a configuration file would have it. Raises yaml.YAMLError."""
    return yaml.load(text, Loader=Loader)  # bounded, and a SafeLoader: builds plain values only


@dataclass
class Document:
    """One layer of configuration: plain values, and where each came from."""

    source: str
    """File name, or `--set`."""
    values: dict[str, Any] = field(default_factory=dict)
    """Plain Python values."""
    marks: dict[Location, tuple[int, int]] = field(default_factory=dict)
    """(line, column), 1-based, of every key."""

    def where(self, location: Location) -> str:
        """`file:line:column` of a key, or of the nearest key around it."""
        for n in range(len(location), 0, -1):
            if location[:n] in self.marks:
                line, column = self.marks[location[:n]]
                return f"{self.source}:{line}:{column}"
        return self.source


def load(path: Path) -> Document:
    """Read a YAML file. Raises ConfigError for a missing file, for broken YAML and for keys given twice."""
    try:
        node = compose(path, "configuration")
    except SourceError as e:
        raise ConfigError(str(e)) from e
    document = Document(str(path))
    if node is None:
        return document
    if not isinstance(node, yaml.MappingNode):
        kind = "list" if isinstance(node, yaml.SequenceNode) else "single value"
        raise ConfigError(f"{path}:1:1: a configuration is a mapping of stages to settings, this is a {kind}")
    errors: list[str] = []
    document.values = _plain(node, (), document, errors)
    if errors:
        raise ConfigError("\n".join(errors))
    return document


def _at(document: Document, node: yaml.Node) -> str:
    return f"{document.source}:{node.start_mark.line + 1}:{node.start_mark.column + 1}"


def _plain(node: yaml.Node, location: Location, document: Document, errors: list[str]) -> Any:
    """Value of a node; notes the mark of every key on the way, and what YAML itself cannot read as a value."""
    if isinstance(node, yaml.MappingNode):
        out: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                errors.append(f"{_at(document, key_node)} a key must be a word, this is a {key_node.id}")
                continue
            key = key_node.value
            here = (*location, key)
            if key in out:
                first = document.where(here)
                errors.append(f"{_at(document, key_node)} {'.'.join(map(str, here))}: given twice, first at {first}")
                continue
            document.marks[here] = (key_node.start_mark.line + 1, key_node.start_mark.column + 1)
            out[key] = _plain(value_node, here, document, errors)
        return out
    if isinstance(node, yaml.SequenceNode):
        items = []
        for i, item in enumerate(node.value):
            document.marks[(*location, i)] = (item.start_mark.line + 1, item.start_mark.column + 1)
            items.append(_plain(item, (*location, i), document, errors))
        return items
    try:
        return Loader("").construct_object(node)
    except (yaml.YAMLError, ValueError) as e:
        why = e.problem if isinstance(e, yaml.MarkedYAMLError) else e
        errors.append(
            f"{_at(document, node)} {'.'.join(map(str, location))}: cannot read {shortened(node.value)} as a value"
            f" ({why}); quote it if it is a text"
        )
        return None
