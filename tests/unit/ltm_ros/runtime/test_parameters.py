import importlib
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from pydantic import BaseModel, Field
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from ltm_core.base.errors import ConfigError
from ltm_ros.launching.graph import NODE_TYPES
from ltm_ros.runtime.handler import NodeConfig
from ltm_ros.runtime.outlet_node import docstrings, read_parameters


class Config(NodeConfig):
    """Parameters of a node for this test."""

    rate: float = Field(2.0, gt=0)
    """Frames per second,
    at most."""
    count: int = Field(3, ge=1, le=9)
    """Number of frames."""
    name: str = "a"
    """Name of the frames."""


@pytest.fixture
def context() -> Iterator[Context]:
    context = Context()
    rclpy.init(context=context)
    yield context
    rclpy.try_shutdown(context=context)


def node(context: Context, **given: Any) -> Node:
    overrides = [Parameter(name, value=value) for name, value in given.items()]
    return Node(
        "described",
        context=context,
        parameter_overrides=overrides,
        automatically_declare_parameters_from_overrides=True,
        start_parameter_services=False,
    )


def test_parameters_are_described_with_limits_and_cannot_be_changed(context: Context) -> None:
    made = node(context, site="ridge.yaml", count=5)
    config = read_parameters(made, Config)
    assert (config.count, config.rate, config.name) == (5, 2.0, "a")
    rate, count, name = (made.describe_parameter(one) for one in ("rate", "count", "name"))
    assert rate.description == "Frames per second, at most."
    assert count.description == "Number of frames."
    (limits,) = count.integer_range
    assert (limits.from_value, limits.to_value) == (1, 9)
    (bounds,) = rate.floating_point_range
    assert (bounds.from_value, bounds.to_value) == (0.0, sys.float_info.max)
    assert not name.floating_point_range
    assert not name.integer_range
    for one in ("rate", "count", "name", "site"):
        value = made.get_parameter(one).value
        (result,) = made.set_parameters([Parameter(one, value=value)])
        assert not result.successful
    assert made.get_parameter("count").value == 5
    made.destroy_node()


@pytest.mark.parametrize("given", [{"count": 10}, {"rate": 0.0}, {"speed": 1}])
def test_a_value_beyond_its_limits_and_an_unknown_name_are_errors(context: Context, given: dict[str, Any]) -> None:
    made = node(context, site="ridge.yaml", **given)
    with pytest.raises(ConfigError, match=next(iter(given))):
        read_parameters(made, Config)
    made.destroy_node()


@pytest.mark.parametrize("kind", NODE_TYPES)
def test_every_parameter_of_every_node_is_described(kind: str) -> None:
    module = importlib.import_module(f"ltm_ros.nodes.{kind}")
    config: type[BaseModel] = module.NODE.config if hasattr(module, "NODE") else module.CONFIG
    assert config.model_fields.keys() - {name for name, text in docstrings(config).items() if text.strip()} == set()
