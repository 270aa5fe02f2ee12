"""Scores label networks on areas that a person named in photos of many places.

`ltm_lab/config/training/landscape_photos.csv` lists the photos, `landscape_areas.json` their areas, in shares of the
photo's sides. Class `land` is ground of unknown cover: of it only being called sky or water is counted. Photos that
teach have all of their regions labelled in `landscape_labels.zip` besides."""

import csv
import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.label_heads.labelled_frames import LAND, UNKNOWN
from ltm_core.storage.image_io import read_rgb
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.masks import fill
from ltm_core.vision.overlays import scene_of
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.resources import lab_config

ROLES = ("train", "validate", "test", "blind")
_GRID = 400  # pixels across a photo that are compared


@dataclass(frozen=True)
class ListedPhoto:
    """A photo of the list: its id, what it shows, its areas (label id, corners in shares of the sides), and what
    is absent from it (see `ltm_lab.training.statements`)."""

    name: str
    kind: str
    role: str
    areas: tuple[tuple[int, tuple[tuple[float, float], ...]], ...]
    absent: str = ""

    def read(self, folder: Path) -> UInt8Array:
        """Read the photo (H, W, 3) RGB from a folder. Raises RecordingError if it is not there."""
        path = folder / f"{self.name}.jpg"
        if not path.is_file():
            raise RecordingError(f"{path}: not found; landscape_photos.csv names its repository, commit and path")
        return read_rgb(path)

    def drawn(self, index: int, height: int, width: int) -> UInt8Array:
        """Draw an area as ones in zeros (height, width)."""
        area = np.zeros((height, width), np.uint8)
        fill(area, [(u * (width - 1), v * (height - 1)) for u, v in self.areas[index][1]])
        return area


def regions(table: Path, photo: str, height: int, width: int) -> UInt8Array:
    """Return the labels (height, width) of a photo's regions in the file landscape_labels.zip beside the table; UNKNOWN
    where there is none."""
    none = np.full((height, width), UNKNOWN, np.uint8)
    path, name = table.with_name("landscape_labels.zip"), f"{photo}.png"
    if not path.is_file():
        return none
    with zipfile.ZipFile(path) as file:
        if name not in file.namelist():
            return none
        drawn = cv2.imdecode(np.frombuffer(file.read(name), np.uint8), cv2.IMREAD_UNCHANGED)
    return np.asarray(cv2.resize(drawn, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)


def listed_photos(role: str, table: Path = lab_config("training/landscape_photos.csv")) -> list[ListedPhoto]:
    """Return the photos of a role in a table, in order; the file landscape_areas.json beside it has their areas."""
    ids = {label.name.lower(): int(label) for label in Label} | {"land": LAND}
    areas: dict[str, list[tuple[int, tuple[tuple[float, float], ...]]]] = {}
    for area in json.loads(table.with_name("landscape_areas.json").read_text(encoding="utf-8")):
        areas.setdefault(area["photo"], []).append((ids[area["class"]], tuple((u, v) for u, v in area["polygon"])))
    with table.open(encoding="utf-8", newline="") as file:
        return [
            ListedPhoto(row["id"], row["kind"], row["role"], tuple(areas.get(row["id"], [])), row.get("absent") or "")
            for row in csv.DictReader(file)
            if row["role"] == role
        ]


@dataclass(frozen=True)
class Answer:
    """What a network says of one area: `found` (N,) labels, `confidence` (N,), `share` of the photo."""

    kind: str
    truth: int
    found: UInt8Array
    confidence: Float64Array
    share: float

    @property
    def right(self) -> float:
        """Return the share of the area that is called its class; of land, neither sky nor water."""
        if self.truth == LAND:
            return 1.0 - self.called(Label.SKY, Label.WATER)
        return self.called(self.truth)

    def called(self, *labels: int) -> float:
        """Return the share of the area that is called one of `labels`."""
        return float(np.isin(self.found, labels).mean())


def answers_of(segmenter: Segmenter, photos: Sequence[ListedPhoto], folder: Path) -> list[Answer]:
    """Label each photo and read the answer in each of its areas."""
    answers = []
    for photo in photos:
        image = scene_of(photo.read(folder))
        height, width = image.shape[:2]
        step = max(1, round(width / _GRID))
        said = segmenter.segment(image)
        found, confidence = said.labels[::step, ::step], np.asarray(said.confidence[::step, ::step], np.float64)
        for index, (truth, _) in enumerate(photo.areas):
            inside = photo.drawn(index, height, width)[::step, ::step] > 0
            answers.append(
                Answer(photo.kind, truth, found[inside], confidence[inside], float(inside.sum() / inside.size))
            )
    return answers


@dataclass(frozen=True)
class AreaScore:
    """Figures of one set of answers; every photo counts as if of one size, NaN where nothing is to be counted."""

    areas: int
    right: float
    at_80: float
    unlabelled: float
    tree_as_shrub: float
    land_as_sky_or_water: float
    risk: float
    risk_at_80: float


def area_score(answers: Sequence[Answer]) -> AreaScore:
    """Return the score of answers: named areas for the first figures, all ground for land that is called sky or water,
    and the risk among labelled pixels, at full coverage and of their surest 80 %."""
    named = [a for a in answers if a.truth != LAND]
    ground = [a for a in answers if a.truth not in (Label.SKY, Label.WATER)]
    trees = [a for a in named if a.truth == Label.TREE]
    risk, risk_at_80 = _risks(named)
    return AreaScore(
        len(named),
        _mean([(a.right, a.share) for a in named]),
        _mean([(float(a.right >= 0.8), 1.0) for a in named]),
        _mean([(a.called(UNLABELLED), a.share) for a in named]),
        _mean([(a.called(Label.SHRUB), a.share) for a in trees]),
        _mean([(a.called(Label.SKY, Label.WATER), a.share) for a in ground]),
        risk,
        risk_at_80,
    )


def _mean(weighed: Sequence[tuple[float, float]]) -> float:
    total = sum(weight for _, weight in weighed)
    return sum(value * weight for value, weight in weighed) / total if total else float("nan")


def _risks(answers: Sequence[Answer]) -> tuple[float, float]:
    kept = [(a, a.found != UNLABELLED) for a in answers]
    if not any(k.any() for _, k in kept):
        return float("nan"), float("nan")
    confidence = np.concatenate([a.confidence[k] for a, k in kept])
    wrong = np.concatenate([a.found[k] != a.truth for a, k in kept])
    weight = np.concatenate([np.full(int(k.sum()), a.share / a.found.size) for a, k in kept])
    order = np.argsort(-confidence, kind="stable")
    sure = np.cumsum(weight[order]) <= 0.8 * weight.sum()
    return float(np.average(wrong, weights=weight)), float(np.average(wrong[order][sure], weights=weight[order][sure]))
