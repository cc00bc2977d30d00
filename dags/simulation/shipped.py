"""Scenes that ship: a file in `scenes` is one, by its name."""

from __future__ import annotations

from pathlib import Path

from posegaussian.storage.model.errors import ConfigError

SCENES = Path(__file__).with_name("scenes")
"""Scene files that ship; a scene may be named without folder and suffix."""


def shipped_scenes() -> list[str]:
    """Their names."""
    return sorted(f.stem for f in SCENES.glob("*.yaml"))


def scene_file(text: str) -> Path:
    """The file of a scene given by path, or by the name of one that ships. Raises ConfigError."""
    given = Path(text)
    if given.is_file():
        return given
    shipped = SCENES / f"{text}.yaml"
    if shipped.is_file():
        return shipped
    raise ConfigError(
        f"there is no scene {text}: neither a file nor one of those that ship, {', '.join(shipped_scenes())}"
    )
