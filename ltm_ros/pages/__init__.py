"""Render HTML pages, and write figures as JSON."""

import base64
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from ltm_core.base.number_text import difference, number, percent


def write_figures(path: Path, figures: Any) -> None:
    """Write `figures` as JSON, with NumPy's floats; creates folders."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(without_nan(figures), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def without_nan(value: Any) -> Any:
    """Return values that JSON supports: NaN and infinity become null."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def shown(value: object, digits: int = 2) -> str:
    """Return a table's value as text: whole numbers without decimals, others with `digits`."""
    if not isinstance(value, int | float | np.number):
        return str(value)
    return number(float(value), 0 if isinstance(value, int | np.integer) else digits)


def inlined(image: bytes, kind: str) -> str:
    """Return the URL of an image that the page itself contains; `kind`: "png" or "jpeg"."""
    return f"data:image/{kind};base64,{base64.b64encode(image).decode('ascii')}"


def render_page(
    template: str, filters: Mapping[str, Callable[..., Any]], package: str = "ltm_ros.pages", **values: Any
) -> str:
    """Return the HTML of `templates/<template>` of a package, with `filters` and those of numbers added to Jinja's own.

    The templates of this package can be included. A value that is missing is an error."""
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(name) for name in dict.fromkeys((package, "ltm_ros.pages"))]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    environment.filters |= {"number": shown, "percent": percent, "difference": difference} | dict(filters)
    environment.tests["numeric"] = lambda value: isinstance(value, int | float) and not isinstance(value, bool)
    return environment.get_template(template).render(**values)
