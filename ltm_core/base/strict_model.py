"""Base classes of the typed configuration: unknown keys are rejected."""

from pydantic import BaseModel, ConfigDict


class StrictModel(BaseModel):
    """Base class of the parts of a YAML file: unknown keys are errors, and values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=(), allow_inf_nan=False)


class DescribedModel(StrictModel):
    """Base class of a node's parameters. The docstrings of fields are their descriptions in ROS; reading them takes
    some milliseconds for each class."""

    model_config = ConfigDict(use_attribute_docstrings=True)
