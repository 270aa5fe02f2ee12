"""A head: a linear correction of a network's class scores, read from its decoder's maps, taught for one kind of place.

A network's maps tell more apart than its own scores do. A head adds to the score of class k at a pixel
b_k + sum over maps m of w_mk . f_m, f_m being the map's vector there, interpolated bilinearly; as interpolation and the
product commute, each map's part is formed at its own size and enlarged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from ltm_core.errors import ModelError
from ltm_core.types import Float32Array
from ltm_core.vision.label_agreement import Agreement
from ltm_core.vision.manifest import Withdrawal
from ltm_core.vision.picture_domain import HeadDomain


@dataclass(frozen=True, eq=False)
class LabelHead:
    """`weights`: map -> (K, C) float32; `bias`: (K,) float32; `temperature` divides the corrected scores.

    `withdraw`: labels that are left out. `agreement`: what those around say of how sure the others are. `described`:
    name and checksum, for `labels/info`. `doubt`: what is to be told of how it was judged. `domain`: where its photos
    lie, for `head: auto`; None: nobody measured it.
    """

    name: str
    described: str
    weights: Mapping[str, Float32Array]
    bias: Float32Array
    temperature: float
    withdraw: Withdrawal = field(default_factory=Withdrawal)
    agreement: Agreement = field(default_factory=Agreement)
    doubt: str = ""
    domain: HeadDomain | None = None

    @property
    def maps(self) -> tuple[str, ...]:
        """Names of the maps that it reads."""
        return tuple(self.weights)

    def add_to(self, scores: Float32Array, maps: Sequence[Float32Array]) -> None:
        """Correct scores (K, h, w) in place by maps (C, h', w') in the order of `maps`. Raises ModelError on maps of
        another number of channels."""
        scores += self.bias[:, None, None]
        rows, cols = scores.shape[1:]
        for (name, weights), values in zip(self.weights.items(), maps, strict=True):
            if values.ndim != 3 or len(values) != weights.shape[1]:
                raise ModelError(
                    f"head {self.name!r}: map {name!r} is {values.shape}, expected ({weights.shape[1]}, h, w); the "
                    "head was taught for another network"
                )
            # einsum and not a matrix product: BLAS would wake its own threads for a millisecond of work.
            part = np.einsum("kc,cn->kn", weights, values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])
            for score, plane in zip(scores, part, strict=True):
                same = plane.shape == (rows, cols)
                score += plane if same else cv2.resize(plane, (cols, rows), interpolation=cv2.INTER_LINEAR)
