"""Likelihood of a network's labels in a cell of each life form, and the correlation of its errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from pydantic import Field, model_validator

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.fuel.cell_appearance_model import CellAppearanceModel
from ltm_core.fuel.life_form import FORMS, LifeForm

FLOOR = 0.01
"""Minimum share of any label, so that a matrix counted on a few scenes never excludes one."""
NEVER: Final = "unmeasured"
"""State of a network whose labels were never compared with anything."""
_OPEN, _STANDING = (LifeForm.GRASS, LifeForm.BARE), (LifeForm.SHRUB, LifeForm.TREE)


class LabelCorrelation(StrictModel):
    """Intraclass correlations of a network's label errors: how far errors of two pixels of one cell agree beyond
    chance.

    0: each errs for itself; 1: always both. Measured by `label_measurement.look_correlation`.
    """

    cell: float = Field(ge=0, le=1)
    """Correlation of two pixels in one frame."""
    stand: float = Field(ge=0, le=1)
    """Correlation of a pixel of the cell and one of another cell of its stand, some 100 m away, in one frame."""
    view: float = Field(ge=0, le=1)
    """Correlation of two pixels in two frames of one view."""
    network: float = Field(ge=0, le=1)
    """Correlation of two pixels in two views: errors of the network itself."""

    @model_validator(mode="after")
    def _nested(self) -> Self:
        if not (self.cell >= self.view >= self.network and self.cell >= self.stand):
            raise ValueError(f"must fall from cell to stand, and from cell over view to network; got {self}")
        return self

    @property
    def between_cells(self) -> float:
        """Return the correlation of the evidence of two cells of one stand on that stand."""
        return self.stand / self.cell if self.cell > 0 else 0.0

    @property
    def between_frames(self) -> float:
        """Return the correlation of the evidence of two frames of one view on a cell."""
        return self.view / self.cell if self.cell > 0 else 0.0

    @property
    def between_views(self) -> float:
        """Return the correlation of the evidence of two views on a cell."""
        return self.network / self.view if self.view > 0 else 0.0


ALIKE: Final = LabelCorrelation(cell=1.0, stand=1.0, view=1.0, network=1.0)
"""Correlation assumed if none was measured: all errors agree, so that many frames say as much as one pixel."""


@dataclass(frozen=True, eq=False)
class LabelErrors:
    """Label errors of a network. `shares`: (FORMS, FORMS), by [the cell's life form, label]: rows sum to 1, NaN for a
    form on which the network was never tested; its labels are then no evidence. `source`: origin of the figures.
    `appearance`: a model of whole cells, if one was trained; it replaces the shares, and the correlations are of its
    residual errors. `state`: what they were measured on, NEVER for nothing."""

    shares: Float64Array
    correlation: LabelCorrelation
    source: str = ""
    appearance: CellAppearanceModel | None = None
    state: str = "measured"

    def __post_init__(self) -> None:
        known = ~np.isnan(self.shares).any(axis=1)
        good = self.shares.shape == (FORMS, FORMS) and known.any() and (self.shares[known] >= 0).all()
        if not good or not np.allclose(self.shares[known].sum(axis=1), 1.0):
            raise ConfigError(f"label errors must be {FORMS} rows of shares that sum to 1, got {self.shares.tolist()}")

    @property
    def measured(self) -> bool:
        """Return whether the labels were ever compared with anything."""
        return self.state != NEVER

    def log_likelihood(self) -> Float64Array:
        """Return (FORMS, FORMS) log share by [life form, label]; -inf rows for unknown forms."""
        mixed = (1 - FORMS * FLOOR) * self.shares + FLOOR
        return np.where(np.isnan(mixed), -np.inf, np.log(mixed))

    def open_odds(self) -> Float32Array:
        """Return (256,) by label id: log odds that a patch of that label is open (grass or bare ground equally likely)
        rather than woody (shrubs or trees equally likely), for two cells with correlated errors as in one stand. 0 for
        other labels, and for a network that was not tested on all of them."""
        odds = np.zeros(256, np.float32)
        if not self.measured:
            return odds
        kept = [form - 1 for form in (*_OPEN, *_STANDING)]
        shares = np.maximum(self.shares[kept][:, kept], FLOOR)
        log_odds = np.log(shares[: len(_OPEN)].mean(axis=0) / shares[len(_OPEN) :].mean(axis=0))
        odds[[*_OPEN, *_STANDING]] = np.nan_to_num(log_odds) * 2 / (1 + self.correlation.between_cells)
        return odds


UNMEASURED: Final = LabelErrors(np.full((FORMS, FORMS), 0.125) + 0.125 * np.eye(FORMS), ALIKE, NEVER, state=NEVER)
"""The worst plausible errors: one label in four is right, the others are any, and all frames and views of a stand err
alike. Labels then make a life form at most twice as likely as any other, and no cell is confident
(`FusionRules.sure_odds`), so that the prior map has the last word."""
