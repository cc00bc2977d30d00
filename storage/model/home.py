"""`~` as the home folder wherever a user writes a path: a shell leaves it alone in quotes, and in files nobody else
would replace it; and the user's cache folder, which lies there."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

_PREFIX = re.compile(r"(?:--[\w-]+=)?(?:[\w.*-]+=)?(?=~)")
"""What may stand before the path in a word: `--output=`, `key=`, or both."""


def at_home(text: str) -> str:
    """A text that starts with `~` or `~user` as a whole folder, with that user's home folder;
    any other text as it is."""
    return os.path.expanduser(text) if text.startswith("~") else text


def word_at_home(word: str) -> str:
    """A word of the command line, as a shell would leave it without quotes: also behind `--option=` and `key=`."""
    found = _PREFIX.match(word)
    return word[: found.end()] + at_home(word[found.end() :]) if found else word


def user_cache() -> Path:
    """Folder of what was fetched, compiled or worked out once, and can be so again: `posegaussian` in XDG_CACHE_HOME,
    else in the platform's folder for caches.

    Not absolute where nobody has a home: nothing is to be kept there unasked.
    """
    home = Path(os.path.expanduser("~"))
    if chosen := os.environ.get("XDG_CACHE_HOME"):
        base = Path(at_home(chosen))
    elif sys.platform == "darwin":
        base = home / "Library" / "Caches"
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    else:
        base = home / ".cache"
    return base / "posegaussian"
