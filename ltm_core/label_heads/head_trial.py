"""Train a label head and test it on other sites, on what it forgets elsewhere, and on its calibration."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from ltm_core.base.errors import ModelError
from ltm_core.base.types import BoolArray, Float64Array
from ltm_core.label_heads.head_fit import (
    PhotoSamples,
    balanced,
    by_area,
    fit_exponent,
    fit_head,
    photo_samples,
    sites_of,
)
from ltm_core.label_heads.labelled_frames import Frame
from ltm_core.scoring.labels import CalibrationScore, SegmentationScore
from ltm_core.vision.label_head import LabelHead, LabelHeadFile
from ltm_core.vision.label_rules import Calibration, LabelAgreement
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.manifest import Withdrawal
from ltm_core.vision.segmenter import Segmenter

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


def teach_head(
    segmenter: Segmenter,
    frames: Sequence[Frame],
    name: str,
    made: str,
    licence: str = "",
    withdrawal: Withdrawal | None = None,
    one_view: bool = False,
) -> HeadTrial:
    """Train a label head on labelled photos.

    Each site's photos are labelled by a head that the other sites taught; from these come scores, agreement and
    calibration. All teach the head that is kept. If all photos are of one site, each is held out in turn, which says
    nothing of other sites. `withdrawal`: which labels the head leaves out. `one_view`: all photos are of one view, for
    which alone the head is: areas are held out instead. Raises ModelError for a network without maps, or for a single
    photo without `one_view`."""
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
        # Of temperature 1: on few sites, the agreement's exponent alone calibrates; a second constant would fit noise.
        fitted, bias = fit_head(by, manifest.maps, one_view)
        parts = np.split(fitted.T, np.cumsum([*manifest.maps.values()])[:-1], axis=1)
        weights = {k: np.ascontiguousarray(w, np.float32) for k, w in zip(manifest.maps, parts, strict=True)}
        return LabelHead(name, name, weights, bias.astype(np.float32), 1.0, rules)

    heads = {g: taught([s for s in samples if s.site != g]) for g in dict.fromkeys(groups)}
    # How sure a head is of a photo is fitted to the photos of other groups, so that the photo had no part in it.
    surety = [_surety(segmenter, heads[g], frame) for g, frame in zip(groups, frames, strict=True)]
    fitted = {g: _agreement([s for other, s in zip(groups, surety, strict=True) if other != g]) for g in heads}
    with_heads = [_with_head(segmenter, replace(heads[g], agreement=fitted[g])) for g in groups]
    before = score_photos([segmenter] * len(frames), frames, counted)
    after = score_photos(with_heads, frames, counted)
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
        agreement=_agreement(surety),
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
) -> HeadScore:
    """Label each frame with the segmenter at its place and compare with the truth."""
    classes = len(segmenters[0].labels)
    labels = SegmentationScore.empty(classes)
    calibration = land_calibration = CalibrationScore.empty()
    for segmenter, frame in zip(segmenters, frames, strict=True):
        found = segmenter.segment(frame.image)
        land = np.where(frame.labels == Label.SKY, np.uint8(UNLABELLED), frame.labels)
        labels = labels.plus(frame.labels, found.labels)
        calibration = calibration.plus(frame.labels, found.labels, found.confidence, classes)
        land_calibration = land_calibration.plus(land, found.labels, found.confidence, classes)
    return HeadScore(labels, calibration, land_calibration, macro)


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
    held = {(int(k), sample.site) for sample in samples for k in np.unique(sample.labels)}
    counts = Counter(k for k, _ in held)
    return tuple(sorted(k for k, sites in counts.items() if sites > 1))


def _with_head(segmenter: Segmenter, head: LabelHead) -> Segmenter:
    return Segmenter(segmenter.manifest, labels=segmenter.labels, head=head)
