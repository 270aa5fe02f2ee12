"""All that is attacked."""

from __future__ import annotations

from fuzz.binary_files import BINARY_FILES
from fuzz.messages import MESSAGES
from fuzz.target import Target
from fuzz.text_files import TEXT_FILES

TARGETS: tuple[Target, ...] = (*TEXT_FILES, *BINARY_FILES, *MESSAGES)


def target_named(name: str) -> Target:
    return next(target for target in TARGETS if target.name == name)
