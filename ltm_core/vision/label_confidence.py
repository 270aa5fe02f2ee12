"""Reads and writes the calibration file beside a model's manifest: `<model>_calibration.yaml`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from pydantic import Field, model_validator

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float64Array
from ltm_core.storage.config_io import load_yaml
from ltm_core.storage.disk_io import is_file
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import CALIBRATION_SUFFIX, NetworkManifest


class Calibration(StrictModel):
    """How a model's labels err: `confusion[i][j]` is P(label j given | label i true), classes in the order of
    `labels.yaml`; `measured_on` says where, and `photographs` on how many photos that were not rendered (None: nobody
    wrote it down)."""

    classes: tuple[str, ...]
    confusion: tuple[tuple[float, ...], ...]
    measured_on: str
    photographs: int | None = Field(default=None, ge=0)
    ece: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _rows_are_distributions(self) -> Calibration:
        count = len(self.classes)
        if len(self.confusion) != count or any(len(row) != count for row in self.confusion):
            raise ValueError(f"confusion must have {count} rows of {count} values, one for each of classes")
        for name, row in zip(self.classes, self.confusion, strict=True):
            if min(row) < 0 or abs(sum(row) - 1.0) > 1e-2:
                raise ValueError(f"confusion: the row of {name} sums to {sum(row):.4f}, expected 1, none below 0")
        return self

    @property
    def on_renderings_alone(self) -> bool:
        """Whether no photo had a part in it, so that labels of photos err more than it says."""
        return self.photographs == 0

    def matrix(self, labels: LabelSet) -> Float64Array:
        """The matrix (K, K) for a label set whose first classes are those of the file; classes appended to the set
        are taken at their word. Raises ModelError for classes in another order."""
        count = len(self.classes)
        if labels.names[:count] != self.classes:
            raise ModelError(
                f"calibration is of classes {', '.join(self.classes)}; the label set has {', '.join(labels.names)}"
            )
        matrix = np.eye(len(labels))
        matrix[:count, :count] = self.confusion
        return np.asarray(matrix / matrix.sum(axis=1, keepdims=True))


def doubt_of_photographs(calibration: Calibration | None) -> str:
    """What is to be told of a network or a head that no photo has judged; empty where one has."""
    if calibration is None:
        return "never scored"
    return "never scored on photographs" if calibration.on_renderings_alone else ""


def calibration_path(manifest_path: Path) -> Path:
    """Where the calibration of a manifest lies."""
    return manifest_path.with_name(f"{manifest_path.stem}{CALIBRATION_SUFFIX}")


def load_calibration(manifest: NetworkManifest) -> Calibration | None:
    """The calibration beside a manifest; None where it has none. Raises ModelError for a file that cannot be taken."""
    path = manifest.folder / f"{manifest.name}{CALIBRATION_SUFFIX}"
    if not is_file(path):
        return None
    try:
        return load_yaml(path, Calibration)
    except ConfigError as reason:
        raise ModelError(str(reason)) from reason


def write_calibration(path: Path, calibration: Calibration) -> None:
    content = {
        "classes": list(calibration.classes),
        "measured_on": calibration.measured_on,
        **({} if calibration.photographs is None else {"photographs": calibration.photographs}),
        "ece": {name: round(value, 4) for name, value in calibration.ece.items()},
        "confusion": [[round(value, 4) for value in row] for row in calibration.confusion],
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)
    path.write_text(f"# confusion: rows are true classes, P(label given | true); written by `ltm train`.\n{text}")
