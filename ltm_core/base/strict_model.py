"""Base class of the typed configuration files: unknown keys are rejected."""

from pydantic import BaseModel, ConfigDict


class StrictModel(BaseModel):
    """Base class of the parts of a YAML file: unknown keys are errors, and values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=(), allow_inf_nan=False)
