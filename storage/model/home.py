"""`~` as the home folder wherever a user writes a path: a shell leaves it alone in quotes, and in files nobody else
would replace it."""

from __future__ import annotations

import os
import re

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
