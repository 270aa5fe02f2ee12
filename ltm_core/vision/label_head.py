"""Correct a network's class scores by a linear label head; read, find and write the files of heads.

A network's maps tell more apart than its own scores do. A label head adds to the score of class k at a pixel
b_k + sum over maps m of w_mk . f_m, f_m being the map's vector there, interpolated bilinearly; as interpolation and the
product commute, each map's part is formed at its own size and enlarged."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import yaml
from pydantic import Field, model_validator

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float32Array
from ltm_core.storage.config_io import load_yaml
from ltm_core.storage.disk_io import is_file
from ltm_core.vision.label_rules import Calibration, LabelAgreement
from ltm_core.vision.manifest import SHIPPED_LABEL_HEAD, NetworkManifest, Withdrawal, added_folder


@dataclass(frozen=True, eq=False)
class LabelHead:
    """`weights`: map -> (K, C) float32; `bias`: (K,) float32; `temperature` divides the corrected scores. `withdraw`:
    thresholds for withdrawing labels. `agreement`: confidence by local agreement. `described`: name and checksum, for
    `labels/info`."""

    name: str
    described: str
    weights: Mapping[str, Float32Array]
    bias: Float32Array
    temperature: float
    withdraw: Withdrawal = field(default_factory=Withdrawal)
    agreement: LabelAgreement = field(default_factory=LabelAgreement)

    def add_to(self, scores: Float32Array, maps: Sequence[Float32Array]) -> None:
        """Correct scores (K, h, w) in place by maps (C, h', w') in the order of `maps`. Raises ModelError."""
        scores += self.bias[:, None, None]
        rows, cols = scores.shape[1:]
        for (name, weights), values in zip(self.weights.items(), maps, strict=True):
            if values.ndim != 3 or len(values) != weights.shape[1]:
                expected = f"expected ({weights.shape[1]}, h, w); it was trained for another network"
                raise ModelError(f"label head {self.name!r}: map {name!r} is {values.shape}, {expected}")
            # einsum and not a matrix product: BLAS would wake its own threads for a millisecond of work.
            part = np.einsum("kc,cn->kn", weights, values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])
            for score, plane in zip(scores, part, strict=True):
                same = plane.shape == (rows, cols)
                score += plane if same else cv2.resize(plane, (cols, rows), interpolation=cv2.INTER_LINEAR)


_Weight = Annotated[float, Field(ge=-1e4, le=1e4)]


class LabelHeadFile(StrictModel):
    """File of a label head. `network` and `sha256` are those of the network whose `maps` it reads, by name: a row for
    each of `classes`, a column for each of the map's channels. `one_view`: it was trained on one view and is for that
    only. `calibration`: errors of its labels on held-out photos."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,60}$")
    network: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    made: str = ""
    licence: str = ""
    classes: tuple[str, ...] = Field(min_length=2)
    temperature: float = Field(gt=0)
    withdraw: Withdrawal = Withdrawal()
    agreement: LabelAgreement = LabelAgreement()
    bias: tuple[_Weight, ...]
    maps: dict[str, tuple[tuple[_Weight, ...], ...]] = Field(min_length=1)
    one_view: bool = False
    calibration: Calibration | None = None

    @model_validator(mode="after")
    def _shapes_agree(self) -> "LabelHeadFile":
        count = len(self.classes)
        if self.name == SHIPPED_LABEL_HEAD:
            raise ValueError(f"name: {SHIPPED_LABEL_HEAD!r} is the network's own label head; choose another")
        if len(self.bias) != count:
            raise ValueError(f"bias has {len(self.bias)} values, expected {count}, one for each of classes")
        for name, rows in self.maps.items():
            widths = {len(row) for row in rows}
            if len(rows) != count or len(widths) != 1 or not max(widths):
                found = f"{len(rows)} rows of {', '.join(map(str, sorted(widths))) or 'none'}"
                raise ValueError(f"maps.{name}: expected {count} rows, each of as many numbers; got {found}")
        return self


def read_label_head(path: Path, manifest: NetworkManifest) -> tuple[LabelHead, LabelHeadFile]:
    """Read a label head for the network of a manifest; return it with the file's content. Raises ModelError, with what
    was expected and what was found: no file, wrong content, another network's head."""
    try:
        content = load_yaml(path, LabelHeadFile)
    except ConfigError as reason:
        raise ModelError(str(reason)) from reason
    own, maps = manifest.name, manifest.maps
    widths = {name: len(rows[0]) for name, rows in content.maps.items()}
    absent = ", ".join(name for name in widths if name not in maps)
    wrong = ", ".join(f"{n} ({width}, not {maps[n]})" for n, width in widths.items() if maps.get(n, width) != width)
    fault = ""
    if content.sha256 != manifest.sha256:
        fault = (
            f"is a label head of network {content.network!r} with sha256 {content.sha256}; the camera's network is "
            f"{own!r} with {manifest.sha256}. Train it again: ltm train head PHOTOS --model {own}"
        )
    elif content.classes != manifest.classes:
        fault = f"has the classes {', '.join(content.classes)}; {own!r} has {', '.join(manifest.classes)}"
    elif absent:
        fault = f"reads map {absent}; {own!r} has {', '.join(maps) or 'none'} (`maps` in its manifest)"
    elif wrong:
        fault = f"weights for another number of channels: {wrong}"
    if fault:
        raise ModelError(f"{path}: {fault}")
    checksum = hashlib.sha256(path.read_bytes()).hexdigest()
    weights = {name: np.asarray(rows, np.float32) for name, rows in content.maps.items()}
    bias, described = np.asarray(content.bias, np.float32), f"{content.name} {checksum[:12]}"
    rules = content.temperature, content.withdraw, content.agreement
    return LabelHead(content.name, described, weights, bias, *rules), content


def find_label_head(name: str, manifest: NetworkManifest, folder: Path | None = None) -> Path | None:
    """Return the file of a camera's label head; None for the network's own, `landscape`. `name`: a path (`*.yaml`), or
    a name that is looked for in `folder` (a site's), beside the manifest and among what the user taught. Raises
    ModelError with every place looked at."""
    if name == SHIPPED_LABEL_HEAD:
        return None
    if name.endswith((".yaml", ".yml")) or os.sep in name:
        places = [Path(name) if folder is None else folder / name]
    else:
        beside = dict.fromkeys([manifest.folder, added_folder()])
        folders = [*([] if folder is None else [folder]), *(label_heads_folder(manifest, one) for one in beside)]
        places = [place / f"{name}.yaml" for place in folders]
    if found := next(filter(is_file, places), None):
        return found
    raise ModelError(
        f"no label head {name!r} of network {manifest.name!r}; searched {', '.join(map(str, places))}. Train one: ltm "
        f"train head PHOTOS --out {Path(name).stem}"
    )


def label_heads_folder(manifest: NetworkManifest, folder: Path | None = None) -> Path:
    """Return the folder of a network's label heads, below the folder of its manifest or of the user's models."""
    return (added_folder() if folder is None else folder) / f"{manifest.name}_heads"


def write_label_head(path: Path, content: LabelHeadFile) -> None:
    """Write a label head; weights with four digits. The folder is made."""
    data = content.model_dump(mode="json", exclude_none=True)
    data["bias"], *_ = _rounded([data["bias"]])
    data["maps"] = {name: _rounded(rows) for name, rows in data["maps"].items()}
    if (calibration := data.get("calibration")) is not None:
        calibration["confusion"] = _rounded(calibration["confusion"])
        calibration["ece"] = {key: round(value, 4) for key, value in calibration["ece"].items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=118)
    path.write_text(f"# A label head of a label network, written by `ltm train head`: docs/labels.md.\n{text}", "utf-8")


def _rounded(rows: list[list[float]]) -> list[list[float]]:
    return [[float(f"{value:.4g}") for value in row] for row in rows]
