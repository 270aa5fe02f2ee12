"""Text of a stranger, such as a camera's name for itself, before it is shown."""

from __future__ import annotations


def plain(text: str, most: int = 1000) -> str:
    """`text` so that it cannot write to a terminal but letters; at most so many."""
    return "".join(letter if letter.isprintable() else "?" for letter in text[:most])
