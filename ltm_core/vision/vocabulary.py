"""Read words: the labels that names of classes stand for (`config/vocabulary.yaml`), and embeddings of words."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import ModelError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float32Array
from ltm_core.storage.config_io import load_arrays, load_yaml
from ltm_core.vision.manifest import NetworkManifest


class Vocabulary(StrictModel):
    """Words by label (`config/vocabulary.yaml`)."""

    synonyms: dict[str, tuple[str, ...]]


def labels_of_classes(names: Sequence[str]) -> dict[str, str]:
    """Return the label of each class of a network whose name is in the vocabulary: `earth, ground` by its first known
    part, and COCO's `tree-merged` as `tree`. Other classes are missing."""
    synonyms = load_yaml(config_path("vocabulary.yaml"), Vocabulary).synonyms
    known = {word: label for label, words in synonyms.items() for word in (*words, label)}
    found: dict[str, str] = {}
    for name in names:
        parts = [part.strip().replace("_", " ") for part in re.split(r"[,;]|--", name.lower())]
        parts = [re.sub(r"-(merged|other|stuff)|\bother-", "", part).strip("- ") for part in parts]
        if label := next((known[part] for part in parts if part in known and part not in _OBJECTS), None):
            found[name] = label
    return found


_OBJECTS = {"canopy", "wood", "broom", "air"}  # ADE20K's canopy is an awning, COCO's wood a material


LARGEST = 64 << 20  # maximum bytes of the words or of their vectors: 20,000 words in 512 dimensions have 40 MB


@dataclass(frozen=True, eq=False)
class TextEmbeddings:
    """Words and their directions: `names` (K), `vectors` (K, D) float32 of length 1, `scale` of the cosine."""

    names: tuple[str, ...]
    vectors: Float32Array
    scale: float

    def scores(self, dense: Float32Array) -> Float32Array:
        """Return `scale` x cosine of each word with each pixel's embedding: (D, h, w) -> (K, h, w)."""
        length = np.sqrt(np.einsum("dhw,dhw->hw", dense, dense))
        # einsum, not a matrix product: that would start threads of its own beside ONNX Runtime's.
        cosine = np.einsum("kd,dhw->khw", self.vectors, dense) / np.maximum(length, 1e-12)
        return np.asarray(np.float32(self.scale) * cosine, np.float32)


def load_text(manifest: NetworkManifest) -> TextEmbeddings:
    """Load the text embeddings of a manifest. Raises ModelError for a missing file, other arrays, another dimension
    than stated, repeated words, or words in `mapping` that are missing."""
    spec = manifest.text
    if spec is None or spec.file is None:
        raise ModelError(
            f"model {manifest.name!r} has no file of text embeddings; its output is {manifest.output.kind}"
        )
    path = manifest.file_of(spec.file)
    words, given = load_arrays(path, ("names", "embeddings"), LARGEST, ModelError)
    if words.dtype.kind not in "US" or given.dtype.kind not in "fiu":
        raise ModelError(f"{path}: names are {words.dtype}, embeddings {given.dtype}; expected texts and numbers")
    names, vectors = tuple(str(name) for name in words.ravel()), np.asarray(given, np.float32)
    if vectors.shape != (len(names), spec.dimensions) or not names:
        found = f"{len(names)} names and embeddings of shape {vectors.shape}"
        raise ModelError(f"{path}: {found}; expected (K, {spec.dimensions}), as text.dimensions states")
    if len(set(names)) != len(names):
        raise ModelError(f"{path}: repeated names; give each word once")
    unknown = sorted(set(manifest.mapping) - set(names))
    if unknown:
        raise ModelError(f"model {manifest.name!r}: mapping names {', '.join(unknown)}, not among the words of {path}")
    return TextEmbeddings(names, unit_vectors(vectors, str(path)), spec.scale)


def unit_vectors(vectors: Float32Array, place: str) -> Float32Array:
    """Return embeddings (N, D) with length 1. Raises ModelError for one that is zero, NaN or infinite."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    if not np.isfinite(vectors).all() or float(length.min()) < 1e-9:
        raise ModelError(f"{place}: an embedding is zero, NaN or infinite; generate the file again")
    return np.asarray(vectors / length, np.float32)
