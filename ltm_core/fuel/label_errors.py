"""Label errors of a network and the reliability records that they come from.

A record belongs to labels, not to a name. Its digest covers the network's file, everything in the manifest that turns
its output into labels, and the label head. A renamed network keeps its record; another file or head has none."""

import hashlib
import json
import re
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import yaml
from pydantic import Field, model_validator

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.fuel.cell_appearance_model import CellAppearanceModel
from ltm_core.fuel.life_form import FORMS, LifeForm
from ltm_core.storage.config_io import load_yaml
from ltm_core.vision.label_head import find_label_head, read_label_head
from ltm_core.vision.manifest import RECORDS, SHIPPED_LABEL_HEAD, NetworkManifest, added_folder, models_folder

FLOOR = 0.01
"""Minimum share of any label, so that a matrix counted on a few scenes never excludes one."""
NEVER: Final = "unmeasured"
"""State of a network whose labels were never compared with anything."""
_OPEN, _STANDING = (LifeForm.GRASS, LifeForm.BARE), (LifeForm.SHRUB, LifeForm.TREE)


class LabelCorrelation(StrictModel):
    """Intraclass correlations of a network's label errors: how far errors of two pixels of one cell agree beyond
    chance. 0: each errs for itself; 1: always both. Measured by `label_measurement.look_correlation`."""

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
            raise ValueError(f"cell must be at least stand and view, and view at least network; got {self}")
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
    residual errors. `state`: what they were measured on, NEVER for nothing. `one_view`: factor of the log odds of a
    cell that only one view has seen, because the network may err alike over a whole slope."""

    shares: Float64Array
    correlation: LabelCorrelation
    source: str = ""
    appearance: CellAppearanceModel | None = None
    state: str = "measured"
    one_view: float = 1.0

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


_NAMES: Final = tuple(form.name.lower() for form in LifeForm)
_LABELS_BY: Final = {"sha256", "input", "output", "classes", "mapping", "text"}
"""Keys of a manifest that change labels."""
_HEAD: Final = """\
# Reliability record of a label network, found by `labels` and not by name (docs/how/fuel.md). What is absent was not
# measured.
"""


class ReliabilityRecord(StrictModel):
    """Reliability record of a network's labels. `source`: what was measured, for people. `labels`: digest of the labels
    (`labels_digest`); empty in a file that a site names. `site`: site on whose recording it was measured. `photos`:
    number of real photos used; None: unknown. `live`: date and frames of a measurement by the running fuel map. `ece`:
    calibration error of the confidence by set. `one_view`: as in `LabelErrors`."""

    source: str = Field(min_length=1)
    network: str = ""
    labels: str = Field("", pattern=r"^([0-9a-f]{64})?$")
    site: str = ""
    live: str = ""
    photos: int | None = Field(None, ge=0)
    ece: dict[str, float] = Field(default_factory=dict)
    one_view: float = Field(1.0, ge=0, le=1)
    correlation: LabelCorrelation | None = None
    shares: dict[str, dict[str, float]] | None = None
    appearance: CellAppearanceModel | None = None

    @model_validator(mode="after")
    def _names_are_life_forms(self) -> Self:
        for form, row in (self.shares or {}).items():
            if strange := [name for name in (form, *row) if name not in _NAMES]:
                raise ValueError(
                    f"shares.{form}: {', '.join(strange)} not a life form; life forms are {', '.join(_NAMES)}"
                )
            if min(row.values(), default=0) < 0 or not sum(row.values()) > 0:
                raise ValueError(f"shares.{form}: shares must be 0 or more, not all 0; got {row}")
        return self

    @property
    def state(self) -> str:
        """Return what the labels were measured on."""
        if self.site:
            return f"measured on site {self.site}" + (f", live ({self.live})" if self.live else "")
        return "measured on renderings only" if self.photos == 0 else "measured on photos"

    def errors(self) -> LabelErrors:
        """Return the label errors; what was not measured is as bad as plausible."""
        if self.shares is None and self.appearance is None and self.correlation is None:
            return UNMEASURED
        shares = UNMEASURED.shares
        if self.shares is not None:
            shares = np.full((FORMS, FORMS), np.nan)
            for form, row in self.shares.items():
                shares[_NAMES.index(form)] = np.array([row.get(name, 0.0) for name in _NAMES]) / sum(row.values())
        return LabelErrors(shares, self.correlation or ALIKE, self.source, self.appearance, self.state, self.one_view)


def stated_errors(path: Path) -> LabelErrors:
    """Load label errors that a site file names, or those of a live record. Raises ConfigError on invalid names and
    values."""
    record = load_yaml(path, ReliabilityRecord)
    errors = record.errors()
    return replace(errors, state=f"stated in {path.name}") if errors.measured and not record.live else errors


def known_errors(
    model: str | NetworkManifest, head: str = SHIPPED_LABEL_HEAD, heads: Path | None = None
) -> LabelErrors:
    """Return the errors of the labels of a network, by its manifest or its name or path, with a label head. They are
    those of the record of these labels; without one, those on the photos that did not train the label head; else
    UNMEASURED, also for a network that is not installed here. Raises ConfigError for an invalid record, ModelError for
    a head that cannot be taken."""
    try:
        manifest = NetworkManifest.find(model).serving(head)
    except ModelError:
        return UNMEASURED
    file = find_label_head(head, manifest, heads)
    record = find_record(manifest, file)
    if record is None and file is not None and (found := read_label_head(file, manifest)[1].calibration) is not None:
        shares = shares_of(found.classes, np.array(found.confusion))
        about = f"label head {head}, on {found.measured_on}"
        record = ReliabilityRecord(source=about, photos=found.photographs, shares=shares)
    return UNMEASURED if record is None else record.errors()


def labels_digest(manifest: NetworkManifest, head: Path | None = None) -> str:
    """Return the digest of what makes the labels of photos: the network's file, how its output becomes labels, its
    words if they are installed, and the file of the label head."""
    content: dict[str, Any] = manifest.model_dump(mode="json", include=_LABELS_BY, exclude_defaults=True)
    content["mapping"] = {name: label for name, label in manifest.mapping.items() if label != "unlabelled"}
    files = [] if head is None else [head]
    if manifest.text is not None and (words := manifest.text.file) is not None:
        content["text"].pop("file")
        with suppress(ModelError):
            files.append(manifest.file_of(words))
    content["files"] = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
    return hashlib.sha256(json.dumps(_rounded(content), sort_keys=True).encode()).hexdigest()


def _rounded(value: Any) -> Any:
    """Return a JSON value whose numbers have six digits, so that 1/255 is the same however it is written."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return f"{value:.6g}" if isinstance(value, int | float) and not isinstance(value, bool) else value


def find_record(manifest: NetworkManifest, head: Path | None = None) -> ReliabilityRecord | None:
    """Return the record of the labels of a network with a label head: the user's own, else one beside the manifest or
    a shipped one; None if there is none. Raises ConfigError for an invalid record."""
    labels = labels_digest(manifest, head)
    folders = dict.fromkeys((added_folder(), manifest.folder, models_folder()))
    found = next(filter(None, (record_file(labels, folder) for folder in folders)), None)
    return None if found is None else load_yaml(found, ReliabilityRecord)


def record_file(labels: str, folder: Path) -> Path | None:
    """Return the file with the record of labels of this digest in a folder of models; None if there is none. Raises
    ConfigError for an invalid record."""
    files = sorted((folder / RECORDS).glob(f"*_{labels[:12]}.yaml"))
    return next((path for path in files if load_yaml(path, ReliabilityRecord).labels == labels), None)


def write_record(record: ReliabilityRecord, folder: Path | None = None) -> Path:
    """Write a record to a folder of models, by default the user's, over that of the same labels; return its path.
    Raises ConfigError if it cannot be written."""
    name = re.sub(r"[^\w.-]+", "_", record.network)
    path = (folder or added_folder()) / RECORDS / f"{name}_{record.labels[:12]}.yaml"
    content = record.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=118)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_HEAD + text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); check the folder's permissions") from error
    return path


def record_of(errors: LabelErrors, source: str, **about: Any) -> ReliabilityRecord:
    """Return a record of label errors; `about`: its further fields."""
    look = None if errors.appearance is None else errors.appearance.rounded()
    rows = zip(_NAMES, np.round(errors.shares, 4), strict=True)
    shares = {name: dict(zip(_NAMES, row.tolist(), strict=True)) for name, row in rows if np.isfinite(row).all()}
    about |= {"shares": shares, "correlation": errors.correlation, "one_view": errors.one_view}
    return ReliabilityRecord(source=source, appearance=look, **about)


def shares_of(classes: tuple[str, ...], confusion: Float64Array) -> dict[str, dict[str, float]]:
    """Return the shares of a record from a confusion matrix (K, K) by [true class, label]."""
    forms = [(index, name) for index, name in enumerate(classes) if name in _NAMES]
    return {
        name: {label: round(float(confusion[row, column]), 4) for column, label in forms}
        for row, name in forms
        if confusion[row, [column for column, _ in forms]].sum() > 0
    }
