"""Train a label head and test it on other sites, on what it forgets elsewhere, and on its calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from ltm_core.base.errors import ModelError
from ltm_core.base.types import BoolArray, Float64Array, UInt8Array
from ltm_core.label_heads.head_fit import (
    FittedHead,
    PhotoSamples,
    balanced,
    by_area,
    fit_exponent,
    fit_head,
    photo_samples,
    sites_of,
)
from ltm_core.label_heads.labelled_frames import Frame
from ltm_core.pictures.legend import label_legend, to_png, with_legend
from ltm_core.pictures.photo_overlays import overlay_labels
from ltm_core.scoring.labels import CalibrationScore, SegmentationScore
from ltm_core.vision.label_head import LabelHead, LabelHeadFile
from ltm_core.vision.label_rules import Calibration, LabelAgreement
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet
from ltm_core.vision.manifest import Withdrawal
from ltm_core.vision.segmenter import Segmentation, Segmenter

AGREEMENT: Final = LabelAgreement(reach=0.006)
"""Agreement filter before its exponent is fitted. The radius, 8 pixels of 1280, was chosen on five held-out tower
views."""
LAND_AND_SKY: Final = (Label.SKY, Label.GRASS, Label.SHRUB, Label.TREE, Label.BARE)
_SEED = 0


@dataclass(frozen=True, eq=False)
class HeadScore:
    """Scores of labels against truth. `macro`: the classes of the mean F1. `land_calibration` ignores true sky pixels,
    which are many and easy."""

    labels: SegmentationScore
    calibration: CalibrationScore
    land_calibration: CalibrationScore
    macro: tuple[int, ...]

    @property
    def macro_f1(self) -> float:
        """Return the mean F1 of the classes `macro`."""
        return self.labels.macro_f1(self.macro)

    def summary(self, names: Sequence[str]) -> dict[str, object]:
        """Return all figures, ready for JSON but for NaN where a class does not occur."""
        return {
            "pixels": self.labels.pixels,
            "f1": dict(zip(names, self.labels.f1.tolist(), strict=True)),
            "macro_f1": self.macro_f1,
            "macro_f1_of": [names[k] for k in self.macro],
            "accuracy": self.labels.accuracy,
            "unlabelled": self.labels.unlabelled,
            "ece": self.calibration.ece,
            "land": {"ece": self.land_calibration.ece, "risk": self.land_calibration.risk()},
            "confusion": self.labels.confusion.tolist(),
        }


@dataclass(frozen=True, eq=False)
class HeadTrial:
    """Trained label head and its scores. `before`, `after`: of the photos, by the network and by label heads trained on
    photos of other sites (`folds`: the way photos were separated); their macro F1 is of the classes that two sites
    show."""

    file: LabelHeadFile
    sites: tuple[str, ...]
    folds: str
    before: HeadScore
    after: HeadScore

    @property
    def better(self) -> bool:
        """Return whether the macro F1 rose."""
        return self.after.macro_f1 > self.before.macro_f1


def teach_head(
    segmenter: Segmenter,
    frames: Sequence[Frame],
    name: str,
    made: str,
    licence: str = "",
    withdrawal: Withdrawal | None = None,
    one_view: bool = False,
    look: Callable[[Frame, Segmentation], None] = lambda frame, found: None,
) -> HeadTrial:
    """Train a label head on labelled photos.

    Each site's photos are labelled by a head that the other sites taught; from these answers come scores, agreement
    and calibration. The head that is kept is taught by all. Where all photos are of one site, each photo is
    held out in turn, which says nothing of other sites. How sure a head is of a photo held out is fitted to others.
    `withdrawal`: which labels the head leaves out. `look` gets the answer to each photo held out. `one_view`: all
    photos are of one view, which the head is for alone: areas are held out instead. Raises ModelError for a network
    without maps, or for a single photo without `one_view`."""
    manifest = segmenter.manifest
    if not manifest.maps:
        raise ModelError(f"model {manifest.name!r} has no decoder maps in its manifest; label heads need them")
    ids = [segmenter.labels.id_of(manifest.mapping.get(name, "unlabelled")) for name in manifest.classes]
    if ids != list(range(len(ids))):
        raise ModelError(
            f"model {manifest.name!r}: a label head needs a network whose classes are the labels, in order"
        )
    photos = len(frames)
    if photos < 2 and not one_view:
        raise ModelError(
            "one photo cannot both train and test a label head; label a photo of another site too, or "
            "restrict the label head to this view (--one-view)"
        )
    rng = np.random.default_rng(_SEED)
    sites = sites_of(list(frames))
    folds, groups = "by site", sites
    if one_view:
        folds, (frames, groups) = "by area, all of one view", by_area(frames)
    elif len(set(sites)) == 1:
        folds, groups = "by photo, all of one site", [frame.path.name for frame in frames]
    samples = [photo_samples(segmenter, frame, site, rng) for frame, site in zip(frames, groups, strict=True)]
    counted = _shared(samples)
    if not counted:
        where = "areas" if one_view else "photos of two sites"
        raise ModelError(f"no class is labelled in two {where}, so nothing can be tested; label more areas")
    rules = withdrawal or Withdrawal()

    def taught(by: Sequence[PhotoSamples]) -> LabelHead:
        return as_head(name, fit_head(by, manifest.maps, one_view), manifest.maps, rules)

    heads = {g: taught([s for s in samples if s.site != g]) for g in dict.fromkeys(groups)}
    judged, alike = _judged_by_others(segmenter, frames, groups, heads)
    with_heads = [_with_head(segmenter, judged[g]) for g in groups]
    before = score_photos([segmenter] * len(frames), frames, counted)
    after = score_photos(with_heads, frames, counted, look)
    names = manifest.classes
    errors = {"photos": after.calibration.ece, "land": after.land_calibration.ece}
    calibration = Calibration(
        classes=segmenter.labels.names,
        confusion=tuple(tuple(float(v) for v in row) for row in balanced([after.labels.confusion])),
        measured_on=f"{photos} photos of {len(set(sites))} sites, held out {folds}",
        photographs=len({frame.path for frame in frames if not frame.rendered}),
        ece={name: ece for name, ece in errors.items() if np.isfinite(ece)},  # none where all is withdrawn
    )
    final = taught(samples)
    file = LabelHeadFile(
        name=name,
        network=manifest.name,
        sha256=manifest.sha256,
        made=made,
        licence=licence,
        classes=names,
        temperature=final.temperature,
        withdraw=rules,
        agreement=alike,
        bias=tuple(map(float, final.bias)),
        maps={key: tuple(tuple(map(float, row)) for row in rows) for key, rows in final.weights.items()},
        one_view=one_view,
        calibration=calibration,
    )
    return HeadTrial(file, tuple(dict.fromkeys(sites)), folds, before, after)


def score_photos(
    segmenters: Sequence[Segmenter],
    frames: Sequence[Frame],
    macro: tuple[int, ...] = LAND_AND_SKY,
    look: Callable[[Frame, Segmentation], None] = lambda frame, found: None,
) -> HeadScore:
    """Label each frame with the segmenter at its place and compare with the truth; `look` receives each result."""
    classes = len(segmenters[0].labels)
    labels = SegmentationScore.empty(classes)
    calibration = land_calibration = CalibrationScore.empty()
    for segmenter, frame in zip(segmenters, frames, strict=True):
        found = segmenter.segment(frame.image)
        land = np.where(frame.labels == Label.SKY, np.uint8(UNLABELLED), frame.labels)
        labels = labels.plus(frame.labels, found.labels)
        calibration = calibration.plus(frame.labels, found.labels, found.confidence, classes)
        land_calibration = land_calibration.plus(land, found.labels, found.confidence, classes)
        look(frame, found)
    return HeadScore(labels, calibration, land_calibration, macro)


def _judged_by_others(
    segmenter: Segmenter, frames: Sequence[Frame], groups: Sequence[str], heads: Mapping[str, LabelHead]
) -> tuple[dict[str, LabelHead], LabelAgreement]:
    """Return the heads of the groups held out as they are scored, with the agreement that the photos of the other
    groups gave, so that no photo had a part in how sure the head is that labels it; and the agreement of all."""
    surety = [_surety(segmenter, heads[g], frame) for g, frame in zip(groups, frames, strict=True)]
    judged = {
        group: replace(head, agreement=_agreement([s for g, s in zip(groups, surety, strict=True) if g != group]))
        for group, head in heads.items()
    }
    return judged, _agreement(surety)


def _surety(segmenter: Segmenter, head: LabelHead, frame: Frame) -> tuple[Float64Array, BoolArray]:
    """Of land in a photo held out, for sky is easy: the agreement of each pixel, and whether its label is right."""
    found = _with_head(segmenter, replace(head, agreement=AGREEMENT)).segment(frame.image)
    land = (frame.labels < len(segmenter.labels)) & (frame.labels != Label.SKY) & (found.labels != UNLABELLED)
    return found.confidence[land] / 255, found.labels[land] == frame.labels[land]


def _agreement(surety: Sequence[tuple[Float64Array, BoolArray]]) -> LabelAgreement:
    """Return the agreement with the exponent that makes it the share of right labels."""
    return AGREEMENT.model_copy(update={"exponent": round(fit_exponent(surety), 3)})


def _shared(samples: Sequence[PhotoSamples]) -> tuple[int, ...]:
    """Return the classes that two held-out groups hold at least: of others, none teaches the one that judges."""
    groups: dict[int, set[str]] = {}
    for sample in samples:
        for k in np.unique(sample.labels):
            groups.setdefault(int(k), set()).add(sample.site)
    return tuple(sorted(k for k, names in groups.items() if len(names) > 1))


def as_head(name: str, fitted: FittedHead, channels: Mapping[str, int], withdrawal: Withdrawal) -> LabelHead:
    """Return a fitted label head in its usable form, before it has a file. Its temperature is 1: on few sites, the
    exponent of agreement alone calibrates confidence; a second constant would fit noise."""
    weights, start = {}, 0
    for key, count in channels.items():
        weights[key] = np.ascontiguousarray(fitted.weights[start : start + count].T, dtype=np.float32)
        start += count
    return LabelHead(name, name, weights, fitted.bias.astype(np.float32), 1.0, withdrawal)


def _with_head(segmenter: Segmenter, head: LabelHead) -> Segmenter:
    return Segmenter(segmenter.manifest, labels=segmenter.labels, head=head)


class LabelledPhoto(Protocol):
    """A photo (H, W, 3) uint8 RGB and the true class of each pixel (H, W) uint8, 255 unknown."""

    @property
    def image(self) -> UInt8Array: ...
    @property
    def labels(self) -> UInt8Array: ...


class StoredPhoto(LabelledPhoto, Protocol):
    """A labelled photo with the path of its file."""

    @property
    def path(self) -> Path: ...


def write_overlay(folder: Path, network: str, labels: LabelSet, frame: StoredPhoto, found: Segmentation) -> None:
    """Write `<folder>/<set>_<frame>_<network>.png`: true labels on the left, the network's on the right."""
    drawn = [overlay_labels(frame.image, each, labels) for each in (frame.labels, found.labels)]
    sheet = np.concatenate(drawn, axis=1)
    sheet = with_legend(sheet, label_legend(sheet.shape[1], labels))
    folder.mkdir(parents=True, exist_ok=True)
    path = frame.path
    name = f"{path.parent.resolve().name}_{path.stem}_{network.replace(' ', '_')}.png"
    (folder / name).write_bytes(to_png(sheet))
