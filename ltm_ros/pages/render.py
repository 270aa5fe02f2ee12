"""Renders HTML pages from templates: one file each, without any outside resource."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jinja2


def render_page(
    template: str, filters: Mapping[str, Callable[..., Any]], package: str = "ltm_ros.pages", **values: Any
) -> str:
    """Return the HTML of `templates/<template>` of a package, with `filters` added to Jinja's own.

    The templates of this package can be included. A value that is missing is an error.
    """
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(name) for name in dict.fromkeys((package, "ltm_ros.pages"))]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    environment.filters |= filters
    environment.tests["numeric"] = lambda value: isinstance(value, int | float) and not isinstance(value, bool)
    return environment.get_template(template).render(**values)
