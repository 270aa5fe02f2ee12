"""What a network calls the pixels of a cell of each life form: the likelihood of its labels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ltm_core.config_io import load_yaml
from ltm_core.errors import ConfigError
from ltm_core.fuel.life_form import FORMS, LifeForm
from ltm_core.resources import config_path
from ltm_core.vision.strict import StrictModel

FLOOR = 0.01
"""The least share that any label is taken to have: a matrix counted on a few scenes never rules anything out."""
_NAMES = tuple(form.name.lower() for form in LifeForm)


class _ErrorsFile(StrictModel):
    source: str = Field(min_length=1)
    shares: dict[str, dict[str, float]]

    @model_validator(mode="after")
    def _names_are_life_forms(self) -> _ErrorsFile:
        for form, row in self.shares.items():
            if strange := [name for name in (form, *row) if name not in _NAMES]:
                raise ValueError(f"shares.{form}: {', '.join(strange)} is no life form; they are {', '.join(_NAMES)}")
            if min(row.values(), default=0) < 0 or not sum(row.values()) > 0:
                raise ValueError(f"shares.{form}: shares must be 0 or more, not all 0; got {row}")
        return self


@dataclass(frozen=True, eq=False)
class LabelErrors:
    """`shares`: (FORMS, FORMS), by [the cell's life form, label]: rows sum to 1, NaN for a form that the network was
    never tried on, which its labels then are no evidence of.
    """

    shares: NDArray[np.float64]
    source: str = ""

    def __post_init__(self) -> None:
        known = ~np.isnan(self.shares).any(axis=1)
        good = self.shares.shape == (FORMS, FORMS) and known.any() and (self.shares[known] >= 0).all()
        if not good or not np.allclose(self.shares[known].sum(axis=1), 1.0):
            raise ConfigError(f"label errors must be {FORMS} rows of shares that sum to 1, got {self.shares.tolist()}")

    @classmethod
    def load(cls, path: Path) -> LabelErrors:
        """From YAML: `shares: {grass: {grass: 0.8, shrub: 0.2}, ...}`. Raises ConfigError on wrong names and values."""
        content = load_yaml(path, _ErrorsFile)
        shares = np.full((FORMS, FORMS), np.nan)
        for form, row in content.shares.items():
            values = np.array([row.get(name, 0.0) for name in _NAMES])
            shares[_NAMES.index(form)] = values / values.sum()
        return cls(shares, content.source)

    @classmethod
    def of_model(cls, model: str) -> LabelErrors:
        """Of a network by its manifest's name; `config/fuel/label_errors/default.yaml` for one without its own."""
        folder = config_path("fuel/label_errors")
        own = folder / f"{Path(model).stem}.yaml"
        return cls.load(own if own.is_file() else folder / "default.yaml")

    def log_likelihood(self) -> NDArray[np.float64]:
        """(FORMS, FORMS): log share by [life form, label]; -inf rows for forms that are not known."""
        mixed = (1 - FORMS * FLOOR) * self.shares + FLOOR
        return np.where(np.isnan(mixed), -np.inf, np.log(mixed))
