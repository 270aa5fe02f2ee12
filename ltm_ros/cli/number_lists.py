"""Numbers with commas, as options take them."""

from __future__ import annotations

import math

from ltm_core.errors import ConfigError


def numbers(text: str, option: str, counts: tuple[int, ...] = ()) -> list[float]:
    """Numbers with commas. Raises ConfigError: others, or not as many as the option takes."""
    try:
        values = [float(part) for part in text.replace(";", ",").replace(" ", ",").split(",") if part]
    except ValueError as error:
        raise ConfigError(f"{option} must be numbers with commas, got {text!r}") from error
    if not all(math.isfinite(value) for value in values) or (counts and len(values) not in counts) or not values:
        wanted = f"{' or '.join(map(str, counts))} " if counts else ""
        raise ConfigError(f"{option} wants {wanted}finite numbers with commas, got {text!r}")
    return values
