"""YAML with the position of every key and value, so that a configuration error can say file:line:column."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from posegaussian.storage.model.documents import shortened
from posegaussian.storage.model.errors import ConfigError, SourceError
from posegaussian.storage.model.yaml_documents import PlainConstructor, compose, loader

Location = tuple[str | int, ...]


def parse_value(text: str) -> Any:
    """One value as a configuration file would have it in quotes where it needs them: `100:`, an open range, is a text
    and no mapping of 100 to nothing. Raises ConfigError."""
    try:
        value = loader().load(text)
    except (YAMLError, ValueError) as e:
        problem = e.problem if isinstance(e, MarkedYAMLError) and e.problem else " ".join(str(e).split())
        raise ConfigError(f"{shortened(text)} is not a YAML value: {problem}") from e
    open_ended = isinstance(value, dict) and list(value.values()) == [None] and text.strip().endswith(":")
    return text.strip() if open_ended else value


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
    if not isinstance(node, MappingNode):
        kind = "list" if isinstance(node, SequenceNode) else "single value"
        raise ConfigError(f"{path}:1:1: a configuration is a mapping of stages to settings, this is a {kind}")
    reading = _Reading(document)
    document.values = reading.value(node, ())
    if reading.faults:
        raise ConfigError("\n".join(reading.faults))
    return document


@dataclass
class _Reading:
    """Makes values of the nodes of a document; notes the mark of every key, and every fault."""

    document: Document
    constructor: PlainConstructor = field(default_factory=lambda: loader().constructor)
    faults: list[str] = field(default_factory=list)

    def value(self, node: Node, location: Location) -> Any:
        """What a node stands for; None where YAML cannot read it as a value."""
        if isinstance(node, MappingNode):
            return self._mapping(node, location)
        if isinstance(node, SequenceNode):
            for i, item in enumerate(node.value):
                self.document.marks[(*location, i)] = _place(item)
            return [self.value(item, (*location, i)) for i, item in enumerate(node.value)]
        try:
            return self.constructor.construct_object(node)
        except (YAMLError, ValueError) as e:
            why = e.problem if isinstance(e, MarkedYAMLError) else e
            problem = f"cannot read {shortened(node.value)} as a value ({why}); quote it if it is a text"
            self._fault(node, f"{'.'.join(map(str, location))}: {problem}")
            return None

    def _mapping(self, node: MappingNode, location: Location) -> dict[str, Any]:
        """The keys are texts, whatever they look like, and each is given once."""
        out: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, ScalarNode):
                self._fault(key_node, f"a key must be a word, this is a {key_node.id}")
                continue
            key = (*location, key_node.value)
            if key_node.value in out:
                self._fault(key_node, f"{'.'.join(map(str, key))}: given twice, first at {self.document.where(key)}")
                continue
            self.document.marks[key] = _place(key_node)
            out[key_node.value] = self.value(value_node, key)
        return out

    def _fault(self, node: Node, sentence: str) -> None:
        line, column = _place(node)
        self.faults.append(f"{self.document.source}:{line}:{column} {sentence}")


def _place(node: Node) -> tuple[int, int]:
    return node.start_mark.line + 1, node.start_mark.column + 1
