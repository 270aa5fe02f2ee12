"""Likelihood of a network's labels in a cell of each life form, and the correlation of its errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.fuel.cell_appearance_model import CellAppearanceFile, CellAppearanceModel
from ltm_core.fuel.life_form import FORMS, LifeForm
from ltm_core.storage.config_io import load_yaml
from ltm_core.vision.label_head import find_label_head, read_label_head
from ltm_core.vision.label_rules import Calibration, load_calibration
from ltm_core.vision.manifest import NetworkManifest

FLOOR = 0.01
"""Minimum share of any label, so that a matrix counted on a few scenes never excludes one."""
ASSUMED = "default"
"""Name of the file for networks without a calibration."""
PHOTO_STEP = 1.8
"""Factor between label errors on photos and on renderings: the risk of the shipped network on land, of five views of
real towers against the renderings `training_g`, 0.404 to 0.223 (docs/labels.md)."""
_OPEN, _STANDING = (LifeForm.GRASS, LifeForm.BARE), (LifeForm.SHRUB, LifeForm.TREE)
_NAMES = tuple(form.name.lower() for form in LifeForm)


class LabelCorrelation(StrictModel):
    """Intraclass correlations of a network's label errors: how far errors of two pixels of one cell agree beyond
    chance.

    0: each errs for itself; 1: always both. Measured against truth by `ltm-lab eval fuel BAG` (`label_correlation`).
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


class _ErrorsFile(StrictModel):
    source: str = Field(min_length=1)
    shares: dict[str, dict[str, float]] | None = None
    correlation: LabelCorrelation | None = None
    appearance: CellAppearanceFile | None = None

    @model_validator(mode="after")
    def _names_are_life_forms(self) -> _ErrorsFile:
        for form, row in (self.shares or {}).items():
            if strange := [name for name in (form, *row) if name not in _NAMES]:
                raise ValueError(
                    f"shares.{form}: {', '.join(strange)} not a life form; life forms are {', '.join(_NAMES)}"
                )
            if min(row.values(), default=0) < 0 or not sum(row.values()) > 0:
                raise ValueError(f"shares.{form}: shares must be 0 or more, not all 0; got {row}")
        return self


@dataclass(frozen=True, eq=False)
class LabelErrors:
    """Label errors of a network. `shares`: (FORMS, FORMS), by [the cell's life form, label]: rows sum to 1, NaN for a
    form on which the network was never tested; its labels are then no evidence. `source`: origin of the figures.
    `appearance`: a model of whole cells, if one was trained; it replaces the shares, and the correlations are of its
    residual errors."""

    shares: Float64Array
    correlation: LabelCorrelation
    source: str = ""
    appearance: CellAppearanceModel | None = None

    def __post_init__(self) -> None:
        known = ~np.isnan(self.shares).any(axis=1)
        good = self.shares.shape == (FORMS, FORMS) and known.any() and (self.shares[known] >= 0).all()
        if not good or not np.allclose(self.shares[known].sum(axis=1), 1.0):
            raise ConfigError(f"label errors must be {FORMS} rows of shares that sum to 1, got {self.shares.tolist()}")

    @classmethod
    def load(cls, path: Path) -> LabelErrors:
        """Load from YAML: `shares: {grass: {grass: 0.8, shrub: 0.2}, ...}`, `correlation: {cell: 0.4, ...}`; missing
        values are those of the assumed network. Raises ConfigError on invalid names and values."""
        content = load_yaml(path, _ErrorsFile)
        appearance = None if content.appearance is None else CellAppearanceModel.of_file(content.appearance)
        if content.shares is not None and content.correlation is not None:
            return cls(_shares(content.shares), content.correlation, content.source, appearance)
        assumed = cls.assumed()
        shares = assumed.shares if content.shares is None else _shares(content.shares)
        return cls(shares, content.correlation or assumed.correlation, content.source, appearance)

    @classmethod
    def assumed(cls) -> LabelErrors:
        """Return the assumed errors of a network without measurements."""
        path = _file_of(ASSUMED)
        content = load_yaml(path, _ErrorsFile)
        if content.shares is None or content.correlation is None:
            raise ConfigError(f"{path}: must give both shares and correlation")
        return cls(_shares(content.shares), content.correlation, content.source)

    @classmethod
    def of_model(cls, model: str) -> LabelErrors:
        """Return the errors of a network by its manifest's name or path.

        Shares are those of the calibration beside its manifest, correlations those of its file in
        `config/fuel/label_errors/`; what neither says is that of the assumed network. Raises ConfigError.
        """
        assumed, own = cls.assumed(), _file_of(Path(model).stem)
        given = load_yaml(own, _ErrorsFile) if own.is_file() else _ErrorsFile(source=assumed.source)
        calibration = _calibration(model)
        correlation = given.correlation or assumed.correlation
        appearance = None if given.appearance is None else CellAppearanceModel.of_file(given.appearance)
        if given.shares is not None:
            return cls(_shares(given.shares), correlation, given.source, appearance)
        if calibration is None:
            return cls(assumed.shares, correlation, given.source, appearance)
        about = f"its calibration on {calibration.measured_on}; of cells: {given.source}"
        errors = cls(_calibrated(calibration, assumed.shares), correlation, about, appearance)
        return errors._for_photographs(calibration)

    @classmethod
    def of_label_head(cls, model: str, head: str, heads: Path | None = None) -> LabelErrors:
        """Return the errors of a network with a label head, by the calibration in the head's file: its errors on photos
        that did not train it.

        How they correlate is assumed, and the looks of cells that were learnt of the network's own labels are not of
        these. Raises ConfigError, ModelError as `find_label_head` and `read_label_head`.
        """
        assumed, manifest = cls.assumed(), NetworkManifest.find(model).serving(head)
        file = find_label_head(head, manifest, heads)
        if file is None:
            return cls.of_model(model)
        content = read_label_head(file, manifest)[1]
        if (calibration := content.calibration) is None:
            return assumed
        about = f"label head {content.name}, on {calibration.measured_on}"
        errors = cls(_calibrated(calibration, assumed.shares), assumed.correlation, about)
        return errors._for_photographs(calibration)

    def _for_photographs(self, calibration: Calibration) -> LabelErrors:
        """Return the errors with the factor from renderings to photos, if no photo was used for the calibration."""
        if not calibration.on_renderings_alone:
            return self
        about = f"{self.source}; not tested on photos, so assumed to be {PHOTO_STEP:g} times as large"
        return replace(self.scaled(PHOTO_STEP), source=about)

    def scaled(self, level: float) -> LabelErrors:
        """Return the errors of a network with `level` times the share of wrong labels, at most all but a tenth of a
        form's."""
        wrong = self.shares * (1 - np.eye(FORMS))
        total = wrong.sum(axis=1, keepdims=True)
        factor = np.minimum(level, 0.9 / np.maximum(total, 1e-9))
        shares = wrong * factor
        return replace(self, shares=shares + np.diag(1 - shares.sum(axis=1)))

    def log_likelihood(self) -> Float64Array:
        """Return (FORMS, FORMS) log share by [life form, label]; -inf rows for unknown forms."""
        mixed = (1 - FORMS * FLOOR) * self.shares + FLOOR
        return np.where(np.isnan(mixed), -np.inf, np.log(mixed))

    def open_odds(self) -> Float32Array:
        """Return (256,) by label id: log odds that a patch of that label is open (grass or bare ground equally likely)
        rather than woody (shrubs or trees equally likely), for two cells with correlated errors as in one stand. 0 for
        other labels, and for a network that was not tested on all of them."""
        odds = np.zeros(256, np.float32)
        kept = [form - 1 for form in (*_OPEN, *_STANDING)]
        shares = np.maximum(self.shares[kept][:, kept], FLOOR)
        log_odds = np.log(shares[: len(_OPEN)].mean(axis=0) / shares[len(_OPEN) :].mean(axis=0))
        odds[[*_OPEN, *_STANDING]] = np.nan_to_num(log_odds) * 2 / (1 + self.correlation.between_cells)
        return odds


def _file_of(name: str) -> Path:
    return config_path("fuel/label_errors") / f"{name}.yaml"


def _shares(rows: dict[str, dict[str, float]]) -> Float64Array:
    shares = np.full((FORMS, FORMS), np.nan)
    for form, row in rows.items():
        values = np.array([row.get(name, 0.0) for name in _NAMES])
        shares[_NAMES.index(form)] = values / values.sum()
    return shares


def _calibration(model: str) -> Calibration | None:
    """Return the calibration of a network; None for one without, and for unknown names."""
    try:
        manifest = NetworkManifest.find(model)
    except ModelError:
        return None
    return load_calibration(manifest)


def _calibrated(calibration: Calibration, otherwise: Float64Array) -> Float64Array:
    """Return the confusion among life forms, that of `otherwise` for forms which the network does not know."""
    shares = otherwise.copy()
    names = {name: index for index, name in enumerate(calibration.classes) if name in _NAMES}
    for form, row in names.items():
        values = np.zeros(FORMS)
        for label, column in names.items():
            values[_NAMES.index(label)] = calibration.confusion[row][column]
        if values.sum() > 0:
            shares[_NAMES.index(form)] = values / values.sum()
    return shares
