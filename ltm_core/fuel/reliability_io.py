"""Read and write reliability records: what was measured about the labels of a network, and on what.

A record belongs to labels, not to a name. Its digest covers the network's file, everything in the manifest that turns
its output into labels, and the label head. A renamed network keeps its record; another file, mapping or head has none.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import yaml
from pydantic import Field, model_validator

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float64Array
from ltm_core.fuel.cell_appearance_model import CellAppearanceFile, CellAppearanceModel
from ltm_core.fuel.label_errors import ALIKE, UNMEASURED, LabelCorrelation, LabelErrors
from ltm_core.fuel.life_form import FORMS, LifeForm
from ltm_core.storage.config_io import load_yaml
from ltm_core.vision.label_head import find_label_head, read_label_head
from ltm_core.vision.manifest import RECORDS, SHIPPED_LABEL_HEAD, NetworkManifest, added_folder, models_folder

_NAMES: Final = tuple(form.name.lower() for form in LifeForm)
_LABELS_BY: Final = {"sha256", "input", "output", "classes", "mapping", "coarse_look", "text"}
"""Keys of a manifest that change labels."""
_HEAD: Final = """\
# Reliability record of a label network, found by `labels` and not by name (docs/how/fuel.md).
# shares: of the labels in cells of each life form. correlation: of the errors of two pixels of a cell, of two cells of
# a stand, of two frames of a view, and of two views. appearance: weights of a constant, of the label shares of the cell
# (grass, shrub, tree, bare, water, built, burned), of these times the confidence over 0.7, and of the shares of the
# cells in front and behind; one row for each incidence. What is absent was not measured.
"""


class ReliabilityRecord(StrictModel):
    """Reliability record of a network's labels. `source`: what was measured, for people. `labels`: digest of the labels
    (`labels_digest`); empty in a file that a site names. `site`: site on whose recording it was measured. `photos`:
    number of real photos used; None: unknown. `ece`: calibration error of the confidence by set."""

    source: str = Field(min_length=1)
    network: str = ""
    labels: str = Field("", pattern=r"^([0-9a-f]{64})?$")
    site: str = ""
    photos: int | None = Field(None, ge=0)
    ece: dict[str, float] = Field(default_factory=dict)
    correlation: LabelCorrelation | None = None
    shares: dict[str, dict[str, float]] | None = None
    appearance: CellAppearanceFile | None = None

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
            return f"measured on site {self.site}"
        return "measured on renderings only" if self.photos == 0 else "measured on photos"

    def errors(self) -> LabelErrors:
        """Return the label errors; what was not measured is as bad as plausible."""
        appearance = None if self.appearance is None else CellAppearanceModel.of_file(self.appearance)
        if self.shares is None and appearance is None and self.correlation is None:
            return UNMEASURED
        shares = UNMEASURED.shares if self.shares is None else _table(self.shares)
        return LabelErrors(shares, self.correlation or ALIKE, self.source, appearance, self.state)


def stated_errors(path: Path) -> LabelErrors:
    """Load label errors that a site file names. Raises ConfigError on invalid names and values."""
    return load_yaml(path, ReliabilityRecord).errors()


def known_errors(model: str, head: str = SHIPPED_LABEL_HEAD, heads: Path | None = None) -> LabelErrors:
    """Return the errors of the labels of a network, by its manifest's name or path, with a label head.

    They are those of the record of these labels; without one, those on the photos that did not train the label head;
    else UNMEASURED, also for a network that is not installed here. Raises ConfigError for an invalid record, ModelError
    for a head that cannot be taken.
    """
    try:
        manifest = NetworkManifest.find(model).serving(head)
    except ModelError:
        return UNMEASURED
    file = find_label_head(head, manifest, heads)
    record = find_record(manifest, file)
    if record is None and file is not None:
        content = read_label_head(file, manifest)[1]
        if (found := content.calibration) is not None:
            about = f"label head {content.name}, on {found.measured_on}"
            shares = shares_of(found.classes, np.array(found.confusion))
            record = ReliabilityRecord(source=about, photos=found.photographs, shares=shares)
    return UNMEASURED if record is None else record.errors()


def labels_digest(manifest: NetworkManifest, head: Path | None = None) -> str:
    """Return the digest of what makes the labels of photos: the network's file, how its output becomes labels, and the
    file of the label head. Raises ModelError if the words of the network are missing."""
    content: dict[str, Any] = manifest.model_dump(mode="json", include=_LABELS_BY, exclude_defaults=True)
    content["mapping"] = {name: label for name, label in manifest.mapping.items() if label != "unlabelled"}
    files = [] if manifest.text is None else [manifest.text_file()]
    content.get("text", {}).pop("file", None)
    content["files"] = [hashlib.sha256(f.read_bytes()).hexdigest() for f in (*files, *([] if head is None else [head]))]
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
    for folder in dict.fromkeys((added_folder(), manifest.folder, models_folder())):
        for path in sorted((folder / RECORDS).glob("*.yaml")):
            if labels in path.read_text(encoding="utf-8", errors="replace"):
                record = load_yaml(path, ReliabilityRecord)
                if record.labels == labels:
                    return record
    return None


def write_record(record: ReliabilityRecord, folder: Path | None = None) -> Path:
    """Write a record to a folder of models, by default the user's, over that of the same labels; return its path.
    Raises ConfigError if it cannot be written."""
    path = (folder or added_folder()) / RECORDS / f"{record.network}_{record.labels[:12]}.yaml"
    content = record.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=118)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_HEAD + text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); check the folder's permissions") from error
    return path


def shares_of(classes: tuple[str, ...], confusion: Float64Array) -> dict[str, dict[str, float]]:
    """Return the shares of a record from a confusion matrix (K, K) by [true class, label]."""
    forms = [(index, name) for index, name in enumerate(classes) if name in _NAMES]
    return {
        name: {label: round(float(confusion[row, column]), 4) for column, label in forms}
        for row, name in forms
        if confusion[row, [column for column, _ in forms]].sum() > 0
    }


def rows_of(shares: Float64Array) -> dict[str, dict[str, float]]:
    """Return the shares of a record from a table (FORMS, FORMS), without its unknown rows."""
    known = [row for row in range(FORMS) if np.isfinite(shares[row]).all()]
    return {_NAMES[row]: dict(zip(_NAMES, np.round(shares[row], 4).tolist(), strict=True)) for row in known}


def _table(rows: dict[str, dict[str, float]]) -> Float64Array:
    shares = np.full((FORMS, FORMS), np.nan)
    for form, row in rows.items():
        values = np.array([row.get(name, 0.0) for name in _NAMES])
        shares[_NAMES.index(form)] = values / values.sum()
    return shares
