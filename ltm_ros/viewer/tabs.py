"""Selects the front tab of a Rerun blueprint, in the form in which a running viewer reports it.

The form is a nested mapping: entity path -> archetype -> field.
"""

from __future__ import annotations

import copy
from typing import Any

from ltm_core.errors import ConfigError


def with_tab(blueprint: dict[str, Any], tab: str) -> dict[str, Any]:
    """The blueprint with another tab in front, by its name, whatever its case; a copy.

    Raises ConfigError, with the names that there are, on a tab that it lacks, or where it has none.
    """
    chosen = copy.deepcopy(blueprint)
    viewport = chosen.get("/viewport", {}).get("ViewportBlueprint", {})
    root = chosen.get(f"/container/{viewport.get('root_container')}", {}).get("ContainerBlueprint", {})
    parts = root.get("contents", []) if root.get("container_kind") == "Tabs" else []
    names = {_name(chosen, part): part for part in parts}
    for name, part in names.items():
        if name.casefold() == tab.casefold():
            root["active_tab"] = part
            return chosen
    raise ConfigError(f"no tab {tab!r}; the recording has: {', '.join(names) or 'no tabs'}")


def _name(blueprint: dict[str, Any], part: str) -> str:
    """What a tab is called; `part` is container/ID or view/ID."""
    fields = blueprint.get(f"/{part}", {})
    named = fields.get("ContainerBlueprint") or fields.get("ViewBlueprint") or {}
    return str(named.get("display_name", part))
