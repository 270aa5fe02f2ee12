"""A tab of the layout, chosen by its name."""

from __future__ import annotations

import pytest

from ltm_core.base.errors import ConfigError

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

from ltm_ros.viewer.server import with_tab


def test_a_tab_is_chosen_by_its_name() -> None:
    told = {
        "/viewport": {"ViewportBlueprint": {"root_container": "a"}},
        "/container/a": {
            "ContainerBlueprint": {
                "active_tab": "container/b",
                "container_kind": "Tabs",
                "contents": ["container/b", "container/c", "view/d"],
            }
        },
        "/container/b": {"ContainerBlueprint": {"container_kind": "Vertical", "display_name": "Site"}},
        "/container/c": {"ContainerBlueprint": {"container_kind": "Grid", "display_name": "Fuel"}},
        "/view/d": {"ViewBlueprint": {"display_name": "Log"}},
    }
    for name, part in (("fuel", "container/c"), ("Log", "view/d"), ("Site", "container/b")):
        chosen = with_tab(told, name)
        assert chosen["/container/a"]["ContainerBlueprint"].pop("active_tab") == part
        chosen["/container/a"]["ContainerBlueprint"]["active_tab"] = "container/b"
        assert chosen == told, "nothing else changes"
    with pytest.raises(ConfigError, match="no tab 'Depth'; the recording has: Site, Fuel, Log"):
        with_tab(told, "Depth")
    with pytest.raises(ConfigError, match="no tabs"):
        with_tab({}, "Site")
