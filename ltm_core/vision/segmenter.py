"""Segment photos of any size into label images with the network of a manifest."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ltm_core.base.errors import ImageError, ModelError
from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.vision.label_head import LabelHead, find_label_head, read_label_head
from ltm_core.vision.label_rules import against_green, agreed, less_likely, withdraw
from ltm_core.vision.labels import UNLABELLED, LabelSet
from ltm_core.vision.manifest import (
    DEFAULT_MODEL,
    SHIPPED_LABEL_HEAD,
    NetworkManifest,
    Withdrawal,
)
from ltm_core.vision.network_image import FittedImage, as_tensor, fitted, token_planes
from ltm_core.vision.onnx_model import OnnxModel
from ltm_core.vision.prompts import prompted
from ltm_core.vision.resampling import upsampled_winner
from ltm_core.vision.vocabulary import load_text


@dataclass(frozen=True)
class Segmentation:
    """Label of each pixel.

    `labels` (H, W) uint8: ids of the label set, 255 unlabelled. `confidence` (H, W) uint8: the network's probability
    of that label x 255, of a head as its `agreement` has it; 0 where unlabelled; 255 wherever labelled by a network
    that gives bare ids."""

    labels: UInt8Array
    confidence: UInt8Array


class Segmenter:
    """Runs the network of a manifest on RGB photos of any size.

    Probabilities of the network's classes that map to one label are summed before the winner is chosen, so that two
    halves of one label (`grass` and `field`, say) are not beaten by a third class. `head`: what corrects the network's
    scores (None: nothing does). `threads` is the number of CPU threads of ONNX Runtime. Raises ModelError: see
    OnnxModel, and for a mapping to a label that does not exist."""

    def __init__(
        self,
        manifest: NetworkManifest,
        threads: int = 1,
        labels: LabelSet | None = None,
        head: LabelHead | None = None,
    ) -> None:
        self.labels = LabelSet.load() if labels is None else labels
        if manifest.text is not None and manifest.text.file is None:
            manifest = prompted(manifest, {}, self.labels)
        self.manifest = manifest.require(depth=False)
        self._text = None if manifest.text is None else load_text(manifest)
        self.classes = manifest.classes if self._text is None else self._text.names
        class_labels = _class_labels(manifest, self.classes, self.labels)
        # group of each network class, and the label of each group
        self._group_labels, self._group_of_class = np.unique(class_labels, return_inverse=True)
        self._label_of_group = np.full(256, UNLABELLED, dtype=np.uint8)
        self._label_of_group[: len(self._group_labels)] = self._group_labels
        self._label_of_id = np.full(256, UNLABELLED, dtype=np.uint8)
        self._label_of_id[: len(class_labels)] = class_labels[:256]
        self._model = OnnxModel(manifest, threads)
        self.head = head
        self.withdraw_otherwise: Mapping[str, float] = {}
        """Fields of `withdrawal` that override those of the label head or the network."""

    @classmethod
    def open(
        cls,
        path_or_name: str | Path | NetworkManifest = DEFAULT_MODEL,
        threads: int = 1,
        labels: LabelSet | None = None,
        head: str = SHIPPED_LABEL_HEAD,
        heads: Path | None = None,
    ) -> "Segmenter":
        """Open a segmenter by its manifest's path, or the name of one in `config/models`, with a label head by its name
        or path.

        With a head, the network is the one that `NetworkManifest.serving` names. `heads`: a folder that is searched for
        the head before others. Raises ModelError: see `find_label_head`, `read_label_head`."""
        manifest = NetworkManifest.find(path_or_name).serving(head)
        file = find_label_head(head, manifest, heads)
        return cls(manifest, threads, labels, head=None if file is None else read_label_head(file, manifest)[0])

    @property
    def name(self) -> str:
        """Return the name of the network and label head, for tables."""
        return self.manifest.name if self.head is None else f"{self.manifest.name} {self.head.name}"

    @property
    def withdrawal(self) -> Withdrawal:
        """Return the thresholds for withdrawing labels."""
        own = self.manifest.output.withdraw if self.head is None else self.head.withdraw
        return own.model_copy(update=dict(self.withdraw_otherwise))

    @property
    def described(self) -> str:
        """Return the names and checksums of network and label head, for `labels/info`."""
        network = f"{self.manifest.name} {self.manifest.sha256[:12]}"
        return network if self.head is None else f"{network}, label head {self.head.described}"

    def segment(self, image: UInt8Array, unlikely: Mapping[int, BoolArray] = MappingProxyType({})) -> Segmentation:
        """Label a photo (H, W, 3) uint8 RGB; the result has the photo's size.

        `unlikely`: by label id the pixels (h, w) of the image, at any size, where the label is unlikely; a network of
        bare ids ignores them. Raises ImageError for another shape or dtype, ModelError if the network's output is not
        what its manifest states."""
        _check(image)
        height, width = image.shape[:2]
        if self.manifest.output.kind == "ids":
            return self._from_ids(fitted(image, self.manifest.input), height, width)
        scores = self._corrected(image)
        probabilities = np.zeros((len(self._group_labels), *scores.shape[1:]), np.float32)
        # Of each label the sum of its classes', without a matrix product, whose threads would spin for cores.
        for group, probability in zip(self._group_of_class, self._probabilities(scores), strict=True):
            probabilities[group] += probability
        np.clip(probabilities, 0.0, 1.0, out=probabilities)
        for label, where in unlikely.items():
            for group in np.flatnonzero(self._group_labels == label):
                less_likely(probabilities, int(group), where)
        winner, confidence = upsampled_winner(probabilities, height, width)
        labels = np.asarray(cv2.LUT(winner, self._label_of_group), np.uint8)
        if UNLABELLED in self._group_labels:
            confidence[labels == UNLABELLED] = 0
        withdraw(image, labels, confidence, self.withdrawal)
        if self.head is not None and self.head.agreement.reach > 0:
            sure = np.rint(np.maximum(255 * agreed(probabilities, self.head.agreement), 1)).astype(np.uint8)
            confidence = np.asarray(cv2.resize(sure, (width, height)), np.uint8)
            confidence[labels == UNLABELLED] = 0
        return Segmentation(labels, confidence)

    def _from_ids(self, photo: FittedImage, height: int, width: int) -> Segmentation:
        output = self._model.outputs(as_tensor(photo.pixels, self.manifest.input))[0]
        ids = np.squeeze(output)
        if ids.ndim != 2:
            raise ModelError(f"model {self.manifest.name!r}: ids have shape {output.shape}, expected (1, h, w)")
        tall, wide = photo.pixels.shape[:2]
        ids = ids[: max(1, round(len(ids) * photo.rows / tall)), : max(1, round(ids.shape[1] * photo.cols / wide))]
        # Out-of-range ids have no class, so no label.
        known = np.where((ids >= 0) & (ids < len(self.classes)), ids, 255).astype(np.uint8)
        labels = cv2.resize(self._label_of_id[known], (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
        labels = np.asarray(labels, dtype=np.uint8)
        return Segmentation(labels, np.where(labels == UNLABELLED, 0, 255).astype(np.uint8))

    def logits(self, image: UInt8Array) -> Float32Array:
        """Return the scores (K, h, w) of the network's classes, with the manifest's offsets and colours, corrected by
        the label head, before any temperature, at the network's resolution.

        Raises ImageError and ModelError as `segment` does, and ModelError for a network that gives ids."""
        if self.manifest.output.kind == "ids":
            raise ModelError(f"model {self.manifest.name!r} outputs class ids; scores need logits or probabilities")
        return self._corrected(image)

    def scores_and_maps(self, image: UInt8Array) -> tuple[Float32Array, dict[str, Float32Array]]:
        """Return the network's own scores (K, h, w), with the manifest's offsets and colours, and all decoder maps (C,
        h', w') of its manifest, on which label heads are trained. Raises as `logits` does."""
        return self._run(image, tuple(self.manifest.maps))

    def _run(self, image: UInt8Array, names: Sequence[str]) -> tuple[Float32Array, dict[str, Float32Array]]:
        _check(image)
        spec = self.manifest.input
        photo = fitted(image, spec)
        tensor = as_tensor(photo.pixels, spec)
        if self.manifest.output.kind == "masks":
            masks, queries = self._model.outputs(tensor)
            return self._scores(mask_scores(masks, queries, len(self.classes)), photo), {}
        output, maps = self._model.run_with_maps(tensor, names)
        maps = [photo.without_padding(planes) for planes in maps]
        return self._scores(output, photo), dict(zip(names, maps, strict=True))

    def _corrected(self, image: UInt8Array) -> Float32Array:
        """Return the network's scores (K, h, w) of a photo, corrected by the head if there is one."""
        scores, maps = self._run(image, () if self.head is None else tuple(self.head.weights))
        if self.head is not None:
            self.head.add_to(scores, list(maps.values()))
        return scores

    def class_probabilities(self, image: UInt8Array) -> dict[str, Float32Array]:
        """Return the probability (h, w) of each of the network's own classes, at its own resolution; raises as `logits`
        does."""
        probabilities = self._probabilities(self.logits(image))
        return dict(zip(self.classes, probabilities, strict=True))

    def _scores(self, output: npt.NDArray[Any], photo: FittedImage) -> Float32Array:
        """Return the network output of a photo -> (K, h, w) of the photo's field of view, checked."""
        spec = self.manifest.output
        if output.ndim == 3 and self._text is not None:
            scores = token_planes(output[0], photo.pixels.shape[:2])
        elif output.ndim == 3 or (output.ndim == 4 and output.shape[0] == len(self.classes) > 1):
            scores = output if output.ndim == 3 else output[:, 0]  # one run per class
        else:
            scores = output[0] if spec.layout == "NCHW" else np.moveaxis(output[0], -1, 0)
        count = len(self.classes) if self._text is None else self._text.vectors.shape[1]
        if scores.ndim != 3 or not (len(scores) == count or (len(scores), count) == (1, 2)):
            raise ModelError(f"model {self.manifest.name!r}: output has shape {output.shape}, expected {count} classes")
        scores = np.ascontiguousarray(photo.without_padding(np.ascontiguousarray(scores, dtype=np.float32)))
        if not np.isfinite(scores.sum()):
            raise ModelError(
                f"model {self.manifest.name!r}: its {spec.kind} hold NaN or infinity; the network is broken"
            )
        for name, offset in spec.offsets.items():
            scores[self.classes.index(name)] += np.float32(offset)
        if spec.redness:
            against = against_green(photo.pixels[: photo.rows, : photo.cols], *scores.shape[1:])
            for name, most in spec.redness.items():
                scores[self.classes.index(name)] -= np.float32(most) * against
        return scores if self._text is None else self._text.scores(scores)

    def _probabilities(self, scores: Float32Array) -> Float32Array:
        """Return the scores (K, h, w) -> probabilities of the network's classes."""
        if self.manifest.output.kind in ("logits", "embeddings"):
            temperature = self.manifest.output.temperature if self.head is None else self.head.temperature
            scores = scores * np.float32(1.0 / temperature)
            scores = np.exp(scores - scores.max(axis=0))
            return np.asarray(scores / scores.sum(axis=0), np.float32)
        if self.manifest.output.kind == "masks":
            return np.asarray(scores / np.maximum(scores.sum(axis=0), 1.0), np.float32)
        low, high = float(scores.min()), float(scores.max())
        if low < -1e-3 or high > 1.0 + 1e-3:
            raise ModelError(
                f"model {self.manifest.name!r}: output lies in {low:.3g}..{high:.3g}, expected probabilities of "
                "0..1; if these are logits, write `kind: logits` in the manifest"
            )
        return np.concatenate([1.0 - scores, scores]) if len(scores) == 1 else scores


def mask_scores(masks: Float32Array, queries: Float32Array, count: int) -> Float32Array:
    """Return the scores (1, K, h, w) of `count` classes from masks (1, Q, h, w) and class logits (1, Q, K or K + 1) of
    queries: the sum over queries of class probability times mask probability (Cheng et al., MaskFormer, 2021).

    Raises ModelError for another number of classes."""
    if queries.ndim != 3 or masks.ndim != 4 or queries.shape[2] not in (count, count + 1):
        raise ModelError(f"query logits have shape {queries.shape}, masks {masks.shape}; expected {count} classes")
    weight = np.exp(queries[0] - queries[0].max(axis=1, keepdims=True))
    weight = (weight / weight.sum(axis=1, keepdims=True))[:, :count]
    inside = 1.0 / (1.0 + np.exp(-np.clip(masks[0], -60.0, 60.0)))
    # einsum, not a matrix product: that would start threads of its own beside ONNX Runtime's.
    return np.asarray(np.einsum("qk,qhw->khw", weight, inside), np.float32)[None]


def _check(image: UInt8Array) -> None:
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
        raise ImageError(f"segment: image is {image.shape} {image.dtype}, expected (H, W, 3) uint8 RGB")


def _class_labels(manifest: NetworkManifest, classes: tuple[str, ...], labels: LabelSet) -> UInt8Array:
    """Our label id of each of the network's classes, (K,) uint8."""
    for name, label in manifest.mapping.items():
        if label != "unlabelled" and label not in labels.names:
            raise ModelError(
                f"model {manifest.name!r}: mapping.{name}: no label {label!r}; "
                f"labels: {', '.join(labels.names)}, unlabelled"
            )
    return np.array([labels.id_of(manifest.mapping.get(name, "unlabelled")) for name in classes], np.uint8)
