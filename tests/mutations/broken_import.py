"""Modules imported from sources that are not those on the disk."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType, ModuleType


class _Loader(SourceFileLoader):
    """Compiles another text than the file's."""

    def __init__(self, name: str, file: str, source: str) -> None:
        super().__init__(name, file)
        self.source = source

    def get_code(self, fullname: str) -> CodeType:
        """The other text's; neither read from nor written to `__pycache__`."""
        return compile(self.source, self.path, "exec", dont_inherit=True)


class BrokenImport(MetaPathFinder):
    """Finds {module: source} before anybody else does."""

    def __init__(self, sources: Mapping[str, str]) -> None:
        self.sources = sources

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The module's own spec with another loader."""
        spec = PathFinder.find_spec(fullname, path, target) if fullname in self.sources else None
        if spec is not None and spec.origin is not None:
            spec.loader = _Loader(fullname, spec.origin, self.sources[fullname])
        return spec


def install(sources: Mapping[str, str]) -> None:
    """Have these modules imported as given from now on. Raises ValueError for one that is imported already."""
    if known := sorted(set(sources) & set(sys.modules)):
        raise ValueError(f"{', '.join(known)}: imported already, so nothing would be broken")
    sys.meta_path.insert(0, BrokenImport(sources))
