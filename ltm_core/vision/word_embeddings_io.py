"""Read word embeddings that are compared with pixel embeddings, for open-vocabulary networks such as LSeg."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import ModelError
from ltm_core.base.types import Float32Array
from ltm_core.storage.text_io import load_arrays
from ltm_core.vision.manifest import NetworkManifest

LARGEST = 64 << 20
"""Maximum bytes of the words or of their vectors: 20,000 words in 512 dimensions have 40 MB."""


@dataclass(frozen=True, eq=False)
class TextEmbeddings:
    """Words and their directions: `names` (K), `vectors` (K, D) float32 of length 1, `scale` of the cosine."""

    names: tuple[str, ...]
    vectors: Float32Array
    scale: float

    def only(self, words: Sequence[str] | None) -> TextEmbeddings:
        """Return these words only, in order; all for None. Raises ModelError for a missing word."""
        if words is None:
            return self
        absent = sorted(set(words) - set(self.names))
        if absent:
            raise ModelError(f"no embedding of {', '.join(absent)}; words: {', '.join(self.names[:40])}")
        return TextEmbeddings(tuple(words), self.vectors[[self.names.index(w) for w in words]], self.scale)

    def scores(self, dense: Float32Array) -> Float32Array:
        """Return `scale` x cosine of each word with each pixel's embedding: (D, h, w) -> (K, h, w)."""
        length = np.sqrt(np.einsum("dhw,dhw->hw", dense, dense))
        # einsum, not a matrix product: that would start threads of its own beside ONNX Runtime's.
        cosine = np.einsum("kd,dhw->khw", self.vectors, dense) / np.maximum(length, 1e-12)
        return np.asarray(np.float32(self.scale) * cosine, np.float32)


def load_text(manifest: NetworkManifest) -> TextEmbeddings:
    """Load the text embeddings of a manifest. Raises ModelError for a missing file, other arrays, another dimension
    than stated, repeated words, or words in `mapping` that are missing."""
    path, spec = manifest.text_file(), manifest.text
    if spec is None:
        raise ModelError(f"model {manifest.name!r} has no text embeddings")
    words, given = load_arrays(path, ("names", "embeddings"), LARGEST, ModelError)
    if words.dtype.kind not in "US" or given.dtype.kind not in "fiu":
        raise ModelError(f"{path}: names are {words.dtype}, embeddings {given.dtype}; expected texts and numbers")
    names, vectors = tuple(str(name) for name in words.ravel()), np.asarray(given, np.float32)
    if vectors.shape != (len(names), spec.dimensions) or not names:
        raise ModelError(
            f"{path}: {len(names)} names and embeddings of shape {vectors.shape}; expected (K, {spec.dimensions}), one "
            "row a name, as text.dimensions states"
        )
    if len(set(names)) != len(names):
        raise ModelError(f"{path}: repeated names; give each word once")
    unknown = sorted(set(manifest.mapping) - set(names))
    if unknown:
        raise ModelError(f"model {manifest.name!r}: mapping names {', '.join(unknown)}, not among the words of {path}")
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    if not np.isfinite(vectors).all() or float(length.min()) < 1e-9:
        raise ModelError(f"{path}: an embedding is zero, NaN or infinite; generate the file again")
    return TextEmbeddings(names, vectors / length, spec.scale)
