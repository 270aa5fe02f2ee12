"""Measures where a network's pictures lie (`ltm-lab train domains`), and where a head's photos do among them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from ltm_core.base.errors import ModelError
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.picture_domain import DomainSpace, HeadDomain, land_statistics
from ltm_core.vision.segmenter import Segmenter

AXES: Final = 16
MAP: Final = "s1"
"""The coarsest map that heads read: it holds most of the place, and its channels are pooled over 3520 places."""
_UNKNOWN: Final = 0.5
"""Of a site, weight of what is known beforehand of a spread: that of the network's own pictures, 1. Chosen with map and
axes on photos of a farm track and of a canyon, each one half against the other, mountain photos and rendered sites; the
tower photos had no part in it."""


def picture_statistics(segmenter: Segmenter, photo: UInt8Array, name: str = MAP) -> Float64Array | None:
    """(2C,) of a photo's land by the map `name`; None where it shows too little. Raises ModelError for a network
    without that map."""
    if name not in segmenter.manifest.maps:
        stated = ", ".join(segmenter.manifest.maps) or "none"
        raise ModelError(f"model {segmenter.manifest.name!r} has no map {name!r}; its manifest states {stated}")
    scores, maps = segmenter.scores_and_maps(photo)
    return land_statistics(maps[name], segmenter.land(scores))


def picture_point(segmenter: Segmenter, space: DomainSpace, photo: UInt8Array) -> Float64Array | None:
    """(D,) where a photo lies among the network's own; None where it shows too little land."""
    scores, maps = segmenter.scores_and_maps(photo)
    return space.point(maps[space.map], segmenter.land(scores))


def fit_space(
    manifest: NetworkManifest, sets: Sequence[Float64Array], measured_on: str, axes: int = AXES
) -> DomainSpace:
    """The axes along which sets of pictures (N, 2C each) that the network was taught on spread most; each set counts
    alike. Raises ModelError where there are hardly more pictures than axes."""
    count = sum(map(len, sets))
    if count < 3 * axes:
        raise ModelError(
            f"{count} pictures that show land; expected {3 * axes} or more, of what the network was taught"
        )
    rows = np.concatenate(sets)
    weight = np.concatenate([np.full(len(s), 1 / (len(s) * len(sets))) for s in sets])
    mean = weight @ rows
    unit = np.sqrt(weight @ (rows - mean) ** 2) + 1e-3
    scaled = (rows - mean) / unit * np.sqrt(weight)[:, None]
    _, spread, turned = np.linalg.svd(scaled, full_matrices=False)
    matrix = turned[:axes] / unit / spread[:axes, None]
    return DomainSpace(
        network=manifest.name,
        sha256=manifest.sha256,
        map=MAP,
        measured_on=measured_on,
        mean=tuple(map(float, mean)),
        axes=tuple(tuple(map(float, row)) for row in matrix),
    )


def fit_head_domain(points: Float64Array, sites: Sequence[str], axes: str) -> HeadDomain:
    """Where photos (N, D) of several sites lie: the mean of the sites' means, and how far a site's photos are from that
    of the others, as it would be of one more site; of a single site, how far its photos are from each other.
    `axes`: checksum of the space that the points are of."""
    names = list(dict.fromkeys(sites))
    groups = [points[[s == name for s in sites]] for name in names]
    if len(groups) == 1:
        groups = [point[None] for point in points]
    means = np.array([group.mean(axis=0) for group in groups])
    count, off = len(groups), 0.0
    if count > 1:
        total = means.sum(axis=0)
        others = [(total - mean) / (count - 1) for mean in means]
        off = float(np.mean([((group - there) ** 2).mean() for group, there in zip(groups, others, strict=True)]))
        # The square of the distance from the mean of n - 1 others goes by 1 + 1 / (n - 1), from that of n by 1 + 1 / n.
        off *= (count**2 - 1) / count**2
    known = count if count > 1 else 0
    spread = float(np.sqrt((known * off + _UNKNOWN) / (known + _UNKNOWN)))
    return HeadDomain(axes=axes, centre=tuple(map(float, means.mean(axis=0))), spread=spread, sites=len(names))


def held_out_odds(points: Float64Array, sites: Sequence[str], axes: str) -> Float64Array:
    """(N,) log odds of each photo for the head, measured on the photos of the other sites. NaN where there are none."""
    odds = np.full(len(points), np.nan)
    for name in dict.fromkeys(sites):
        others = [s != name for s in sites]
        if any(others):
            domain = fit_head_domain(points[others], [s for s in sites if s != name], axes)
            own = [not other for other in others]
            odds[own] = [domain.log_odds(point) for point in points[own]]
    return odds
