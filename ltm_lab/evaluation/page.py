"""Renders HTML pages from the templates beside this module: one file each, without any outside resource."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jinja2


def render_page(template: str, filters: Mapping[str, Callable[..., Any]], **values: Any) -> str:
    """The HTML of `templates/<template>`, with `filters` added to Jinja's own; a value that is missing is an error."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("ltm_lab.evaluation"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    environment.filters |= filters
    environment.tests["numeric"] = lambda value: isinstance(value, int | float) and not isinstance(value, bool)
    return environment.get_template(template).render(**values)
