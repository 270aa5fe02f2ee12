"""Base class of the typed configuration files: unknown keys are rejected."""

from pydantic import BaseModel, ConfigDict


class StrictModel(BaseModel):
    """A part of a YAML file: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=(), allow_inf_nan=False)
