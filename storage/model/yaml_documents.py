"""YAML within bounds: nodes and nesting are counted while a document is composed, with what aliases stand for.

A few lines of YAML can stand for more values than there is memory (&a [*b, *b], &b [*c, *c], ...), or for themselves.
An alias is counted as all that it stands for before anybody walks through it.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from posegaussian.storage.model.documents import DEEPEST, LARGEST_SETTINGS, MOST_DIGITS, read_text
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.home import at_home

MOST_NODES = 30_000
"""Nodes of a document with what its aliases stand for; PyYAML reads about as many in two seconds."""


class BoundedBase(yaml.BaseLoader):
    """PyYAML's loader of texts alone, with bounds."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = self._nodes = 0
        self._known: dict[int, tuple[int, int]] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """One node, counted. Raises yaml.composer.ComposerError at the place of what is too much."""
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            node = super().compose_node(parent, index)
            nodes, height = self._known.get(id(node), (0, 0))
            if not nodes:
                raise _error(event, f"the alias *{event.anchor} holds itself")
            self._count(event, nodes, height)
            return node
        before = self._nodes
        self._count(event, 1, 1)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        self._known[id(node)] = (self._nodes - before, self._height(node))
        return node

    def _count(self, event: yaml.Event, nodes: int, height: int) -> None:
        self._nodes += nodes
        if self._nodes > MOST_NODES:
            raise _error(event, f"more than {MOST_NODES} values, counting all that aliases (*) stand for")
        if self._depth + height > DEEPEST:
            raise _error(event, f"nested more than {DEEPEST} deep")

    def _height(self, node: yaml.Node | None) -> int:
        if not isinstance(node, yaml.CollectionNode):
            return 1
        held = [n for item in node.value for n in (item if isinstance(item, tuple) else (item,))]
        return 1 + max((self._known[id(n)][1] for n in held), default=0)


def _error(event: Any, problem: str) -> yaml.composer.ComposerError:
    return yaml.composer.ComposerError(None, None, problem, event.start_mark)


class Loader(BoundedBase, yaml.SafeLoader):
    """PyYAML's safe loader with the plain values of YAML 1.2: `1:9`, `on` and `no` are text."""

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """A whole number. Raises yaml.constructor.ConstructorError for one that does not fit 64 bits."""
        if len(node.value) > MOST_DIGITS + 1:
            raise yaml.constructor.ConstructorError(
                None,
                None,
                f"a whole number has {len(node.value)} digits, at most {MOST_DIGITS} are read",
                node.start_mark,
            )
        return int(node.value)

    def construct_yaml_str(self, node: yaml.ScalarNode) -> str:
        """A text; of a path that starts with `~`, the one it stands for."""
        return at_home(str(self.construct_scalar(node)))


_YAML_1_1 = {f"tag:yaml.org,2002:{kind}" for kind in ("int", "float", "bool", "timestamp")}
Loader.yaml_implicit_resolvers = {
    first: [r for r in resolvers if r[0] not in _YAML_1_1]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"^[-+]?(?:0|[1-9][0-9]*)$"), list("-+0123456789"))
Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^(?:[-+]?(?:(?:\.[0-9]+|[0-9]+\.[0-9]*)(?:[eE][-+]?[0-9]+)?|[0-9]+[eE][-+]?[0-9]+|\.(?:inf|Inf|INF))|\.(?:nan|NaN|NAN))$"
    ),
    list("-+0123456789."),
)
Loader.add_constructor("tag:yaml.org,2002:int", Loader.construct_yaml_int)
Loader.add_constructor("tag:yaml.org,2002:str", Loader.construct_yaml_str)


def compose(path: str | Path, what: str = "file") -> yaml.Node | None:
    """The nodes of a YAML file, None of an empty one. Raises SourceError with file:line:column."""
    return parse(lambda text: yaml.compose(text, Loader=Loader), path, what)


def read_yaml(path: str | Path, what: str = "file", loader: type[BoundedBase] = Loader) -> Any:
    """The plain values of a YAML file, read with a loader of bounds. Raises SourceError with file:line:column."""
    return parse(
        lambda text: yaml.load(text, Loader=loader), path, what
    )  # bounded, and a SafeLoader: builds plain values only


def parse(reading: Any, path: str | Path, what: str = "file") -> Any:
    """What `reading` makes of the text of a YAML file, its exceptions turned into SourceError with file:line:column."""
    text = read_text(path, what, LARGEST_SETTINGS)
    try:
        return reading(text)
    except yaml.MarkedYAMLError as e:
        mark = e.problem_mark or e.context_mark
        at = f"{path}:{mark.line + 1}:{mark.column + 1}" if mark else str(path)
        raise SourceError(f"{at}: not valid YAML: {e.problem or e}") from e
    except (yaml.YAMLError, ValueError, KeyError, TypeError, OverflowError) as e:
        raise SourceError(f"{path}: not valid YAML: {' '.join(str(e).split())}") from e
    except RecursionError as e:
        raise SourceError(f"{path}: nested too deeply") from e
