"""YAML within bounds: nodes and nesting are counted while a document is composed, with what aliases stand for.

A few lines of YAML can stand for more values than there is memory (&a [*b, *b], &b [*c, *c], ...), or for themselves.
An alias is counted as all that it stands for before anybody walks through it. Values are those of YAML 1.2, and a key
given twice in one mapping is refused.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer, ComposerError
from ruamel.yaml.constructor import BaseConstructor, ConstructorError, SafeConstructor
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import AliasEvent, Event
from ruamel.yaml.nodes import CollectionNode, Node, ScalarNode
from ruamel.yaml.representer import SafeRepresenter
from ruamel.yaml.resolver import Resolver, VersionedResolver

from posegaussian.storage.model.documents import DEEPEST, LARGEST_SETTINGS, MOST_DIGITS, read_text, shortened
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.home import at_home

MOST_NODES = 30_000
"""Nodes of a document with what its aliases stand for; ruamel.yaml reads about as many in two seconds."""


_COLON = "mapping values are not allowed here"
"""What ruamel.yaml says of a colon after a value, such as that of an open range, `range: 100:`."""


class _BoundedComposer(Composer):
    """ruamel.yaml's composer, with bounds."""

    def __init__(self, loader: Any = None) -> None:
        super().__init__(loader)
        self.warn_double_anchors = False  # YAML 1.2 allows an anchor to be used again
        self._level = self._nodes = 0
        self._known: dict[int, tuple[int, int]] = {}

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        """One node, counted. Raises ComposerError at the place of what is too much."""
        event = self.parser.peek_event()
        if isinstance(event, AliasEvent):
            node = super().compose_node(parent, index)
            nodes, height = self._known.get(id(node), (0, 0))
            if not nodes:
                raise _error(event, f"the alias *{event.anchor} holds itself")
            self._count(event, nodes, height)
            return node
        before = self._nodes
        self._count(event, 1, 1)
        self._level += 1
        node = super().compose_node(parent, index)
        self._level -= 1
        self._known[id(node)] = (self._nodes - before, self._height(node))
        return node

    def _count(self, event: Event, nodes: int, height: int) -> None:
        self._nodes += nodes
        if self._nodes > MOST_NODES:
            raise _error(event, f"more than {MOST_NODES} values, counting all that aliases (*) stand for")
        if self._level + height > DEEPEST:
            raise _error(event, f"nested more than {DEEPEST} deep")

    def _height(self, node: Node | None) -> int:
        if not isinstance(node, CollectionNode):
            return 1
        held = [n for item in node.value for n in (item if isinstance(item, tuple) else (item,))]
        return 1 + max((self._known[id(n)][1] for n in held), default=0)


def _error(event: Event, problem: str) -> ComposerError:
    return ComposerError(None, None, problem, event.start_mark)


class TextConstructor(BaseConstructor):
    """Builds texts, lists and mappings whose keys are all given once."""

    def check_mapping_key(self, node: Node, key_node: Node, mapping: Any, key: Any, value: Any) -> bool:
        """That a key is new. Raises ConstructorError."""
        if key in mapping:
            raise ConstructorError(None, None, f"{shortened(key)} is given twice", key_node.start_mark)
        return True


class PlainConstructor(TextConstructor, SafeConstructor):
    """Builds plain values, and nothing else."""

    def construct_yaml_int(self, node: ScalarNode) -> int:
        """A whole number. Raises ConstructorError for one that does not fit 64 bits."""
        if len(node.value) > MOST_DIGITS + 1:
            problem = f"a whole number has {len(node.value)} digits, at most {MOST_DIGITS} are read"
            raise ConstructorError(None, None, problem, node.start_mark)
        return int(node.value)

    def construct_yaml_str(self, node: ScalarNode) -> str:
        """A text; of a path that starts with `~`, the one it stands for."""
        return at_home(str(self.construct_scalar(node)))


PlainConstructor.add_constructor("tag:yaml.org,2002:int", PlainConstructor.construct_yaml_int)
PlainConstructor.add_constructor("tag:yaml.org,2002:str", PlainConstructor.construct_yaml_str)


class TextResolver(VersionedResolver):
    """Every scalar is text, whatever it looks like."""

    processing_version = (1, 2)  # whatever `%YAML` says
    versioned_resolver: Mapping[str, Sequence[tuple[str, re.Pattern[str]]]] = {}  # by first letter: tag, what has it


class PlainResolver(TextResolver):
    """YAML 1.2 as ruamel.yaml has it, but `08`, `1_000` and `2026-01-01` are text: cameras and sequences have such
    names."""


_NUMBERS = (
    ("tag:yaml.org,2002:int", re.compile(r"^[-+]?(?:0|[1-9][0-9]*)$")),
    (
        "tag:yaml.org,2002:float",
        re.compile(
            r"^(?:[-+]?(?:(?:\.[0-9]+|[0-9]+\.[0-9]*)(?:[eE][-+]?[0-9]+)?|[0-9]+[eE][-+]?[0-9]+|\.(?:inf|Inf|INF))"
            r"|\.(?:nan|NaN|NAN))$"
        ),
    ),
)
_WORDS = {f"tag:yaml.org,2002:{kind}" for kind in ("bool", "null", "merge")}
PlainResolver.versioned_resolver = {
    first: [
        *((tag, pattern) for tag, pattern in resolvers if tag in _WORDS),
        *(_NUMBERS if first and first in "-+.0123456789" else ()),
    ]
    for first, resolvers in Resolver.yaml_implicit_resolvers.items()
}


def loader(constructor: type[TextConstructor] = PlainConstructor, resolver: type[TextResolver] = PlainResolver) -> YAML:
    """A reader of YAML within bounds, for one document."""
    made = YAML(typ="safe", pure=True, plug_ins=[])  # it would look for some on the disk every time
    made.Composer, made.Constructor, made.Resolver = _BoundedComposer, constructor, resolver
    return made


def compose(path: str | Path, what: str = "file") -> Node | None:
    """The nodes of a YAML file, None of an empty one. Raises SourceError with file:line:column."""
    return parse(lambda text: loader().compose(text), path, what)


def read_yaml(path: str | Path, what: str = "file") -> Any:
    """The plain values of a YAML file. Raises SourceError with file:line:column."""
    return parse(lambda text: loader().load(text), path, what)


def parse(reading: Callable[[str], Any], path: str | Path, what: str = "file") -> Any:
    """What `reading` makes of the text of a YAML file, its exceptions turned into SourceError with file:line:column."""
    text = read_text(path, what, LARGEST_SETTINGS)
    try:
        return reading(text)
    except MarkedYAMLError as e:
        mark = e.problem_mark or e.context_mark
        at = f"{path}:{mark.line + 1}:{mark.column + 1}" if mark else str(path)
        advice = "; put a text that holds a colon in quotes" if e.problem == _COLON else ""
        raise SourceError(f"{at}: not valid YAML: {e.problem or e}{advice}") from e
    except (YAMLError, ValueError, KeyError, TypeError, OverflowError) as e:
        raise SourceError(f"{path}: not valid YAML: {' '.join(str(e).split())}") from e
    except RecursionError as e:
        raise SourceError(f"{path}: nested too deeply") from e


class _Representer(SafeRepresenter):
    """Writes numbers so that readers of YAML 1.1 take them for numbers, too: they want the point in 1.0e-05."""

    def represent_float(self, data: float) -> ScalarNode:
        """The node of a number."""
        node: ScalarNode = super().represent_float(data)
        if "." not in node.value:
            node.value = node.value.replace("e", ".0e")
        return node


_Representer.add_representer(float, _Representer.represent_float)


def yaml_text(values: Mapping[str, Any]) -> str:
    """Plain values as the text of a YAML file, in their order."""
    writer: Any = YAML(typ="safe", pure=True)
    writer.Representer = _Representer
    writer.default_flow_style = writer.sort_base_mapping_type_on_output = writer.allow_unicode = False
    out = io.StringIO()
    writer.dump(values, out)
    return out.getvalue()
