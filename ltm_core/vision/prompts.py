"""Let a network of text and images name classes by prompts: several for each label, averaged, and negative ones.

Prompts become part of the manifest, as the words of its text file or as its input, so that all that follows (labels,
their digest, checks) is as for any other network."""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.types import Float32Array
from ltm_core.storage.disk_io import written_whole
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.onnx_file import NetworkFile, file_digest
from ltm_core.vision.onnx_model import open_session
from ltm_core.vision.vocabulary import load_text, unit_vectors

OTHER: Final = "other"  # key of negative prompts: pixels that show one of them are unlabelled
_MOST_TOKENS: Final = 77  # length of CLIP's texts, for graphs that take any length
_LONGEST: Final = 200

Prompts = Mapping[str, Sequence[str]]
_Groups = Mapping[str, tuple[str, ...]]


def prompted(manifest: NetworkManifest, prompts: Prompts, labels: LabelSet, shown: str = "") -> NetworkManifest:
    """Return the manifest of a network that labels by prompts; only these compete.

    Args:
        prompts: for each label (or OTHER) its prompts; empty: the names of the labels.
        shown: a prompt that is a class of its own, unlabelled, for a heat map; empty: none.

    Raises ConfigError for other keys and bad prompts; ModelError for a network without text, and bad files."""
    given = dict(prompts) or {name: (name,) for name in labels.names}
    if unknown := sorted(set(given) - set(labels.names) - {OTHER}):
        raise ConfigError(f"vocabulary: no label {unknown[0]!r}; use {', '.join(labels.names)}, or {OTHER}")
    texts = [text for group in (*given.values(), (shown,) if shown else ()) for text in group]
    if bad := [text for text in texts if not text.strip() or len(text) > _LONGEST or texts.count(text) > 1]:
        raise ConfigError(f"vocabulary: prompt {bad[0]!r} is empty, repeated, or longer than {_LONGEST} characters")
    groups = {name: tuple(group) for name, group in given.items() if name != OTHER and group}
    alone = (*given.get(OTHER, ()), *((shown,) if shown else ()))
    if clash := sorted(set(alone) & set(groups)):
        raise ConfigError(f"vocabulary: {clash[0]!r} is a label and a prompt of its own; choose other words")
    mapping = {name: name for name in groups} | dict.fromkeys(alone, "unlabelled")
    groups |= {text: (text,) for text in alone}
    if manifest.output.kind == "embeddings":
        return _by_words(manifest, groups, mapping)
    if manifest.prompts is None:
        raise ModelError(f"model {manifest.name!r} takes no prompts; remove `vocabulary`, or use another network")
    return _by_input(manifest, groups, mapping)


def _by_words(manifest: NetworkManifest, groups: _Groups, mapping: dict[str, str]) -> NetworkManifest:
    """Return the manifest with the mean embedding of each group as its words, in a file of the user's cache."""
    assert manifest.text is not None  # nosec B101 # the manifest's own rule for embeddings
    texts = [text for group in groups.values() for text in group]
    known: dict[str, Float32Array] = {}
    if manifest.text.file is not None:
        words = load_text(manifest)
        known = dict(zip(words.names, words.vectors, strict=True))
    unknown = [text for text in texts if text not in known]
    if unknown and manifest.prompts is None:
        known_by = f"model {manifest.name!r}, which has no text encoder"
        raise ModelError(f"{unknown[0]!r} has no embedding in {known_by}; add it to the text file")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ltm" / "prompts"
    path = cache / f"{_digest(manifest, groups)}.npz"
    if not path.is_file():
        if unknown:
            known |= dict(zip(unknown, encoded(manifest, unknown), strict=True))
        means = np.stack([np.mean([known[text] for text in group], axis=0) for group in groups.values()])
        vectors = unit_vectors(means.astype(np.float32), str(path))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with written_whole(path) as part, part.open("wb") as stream:
                np.savez(stream, names=np.array(tuple(groups)), embeddings=vectors)
        except (ConfigError, OSError) as error:
            raise ModelError(f"{path}: cannot be written; name a writable folder in XDG_CACHE_HOME") from error
    spec = manifest.text.model_copy(update={"file": path})
    return manifest.model_copy(update={"text": spec, "mapping": mapping})


def _by_input(manifest: NetworkManifest, groups: _Groups, mapping: dict[str, str]) -> NetworkManifest:
    """Return the manifest with the prompts as constants of the network's input. Of a network that takes embeddings,
    each group is one class. Of one that takes token ids, each prompt is one, and the probability of a label is the mean
    of those of its prompts: its logits are lowered by ln(number of prompts)."""
    constants: dict[str, Any] = dict(manifest.input.constants)
    ids = [name for name in constants if "ids" in name or "token" in name]
    if not ids:
        name = next(iter(constants), "")
        texts = [text for group in groups.values() for text in group]
        vectors = dict(zip(texts, encoded(manifest, texts), strict=True))
        means = [np.mean([vectors[text] for text in group], axis=0) for group in groups.values()]
        constants[name] = unit_vectors(np.stack(means).astype(np.float32), name).tolist()
        classes, offsets = tuple(groups), {}
    else:
        of = {text: name for name, group in groups.items() for text in group}
        tokens, mask = _tokens(manifest, list(of), None)
        constants[ids[0]] = tokens.tolist()
        constants |= {name: mask.tolist() for name in constants if "mask" in name}
        classes, mapping = tuple(of), {text: mapping[name] for text, name in of.items()}
        offsets = {text: -float(np.log(len(groups[name]))) for text, name in of.items() if len(groups[name]) > 1}
    spec = manifest.input.model_copy(update={"constants": constants})
    output = manifest.output.model_copy(update={"offsets": offsets})
    changes = {"input": spec, "output": output, "classes": classes, "mapping": mapping}
    return manifest.model_copy(update=changes)


def encoded(manifest: NetworkManifest, texts: Sequence[str]) -> Float32Array:
    """Return the embeddings (N, D) of length 1 of texts, by the text encoder of a manifest. Raises ModelError."""
    if manifest.prompts is None or manifest.prompts.encoder is None:
        raise ModelError(f"model {manifest.name!r} has no text encoder; name it as prompts.encoder in its manifest")
    path = manifest.file_of(manifest.prompts.encoder)
    session = open_session(NetworkFile.read(path), path)
    nodes = {node.name: node for node in session.get_inputs()}
    first = next((node for name, node in nodes.items() if "ids" in name), next(iter(nodes.values())))
    length = first.shape[-1] if isinstance(first.shape[-1], int) else None
    tokens, mask = _tokens(manifest, texts, length)
    feed = {name: (mask if "mask" in name else tokens) for name in nodes}
    narrow = [name for name, node in nodes.items() if node.type == "tensor(int32)"]
    feed |= {name: feed[name].astype(np.int32) for name in narrow}
    outputs = [node.name for node in session.get_outputs()]
    try:
        each = ({name: values[i : i + 1] for name, values in feed.items()} for i in range(len(texts)))
        rows = [session.run(outputs, one) for one in each]
    except Exception as reason:  # the runtime's errors have no common base
        raise ModelError(f"{path}: cannot encode text ({reason}); give the text encoder of {manifest.name}") from reason
    flat = [place for place, value in enumerate(rows[0]) if np.ndim(value) == 2 and np.shape(value)[0] == 1]
    named = [place for place in flat if "embed" in outputs[place]] or flat
    if not named:
        raise ModelError(f"{path}: outputs {', '.join(outputs)}; expected one vector per text, such as text_embeds")
    vectors = np.concatenate([np.asarray(row[named[0]], np.float32) for row in rows])
    if manifest.text is not None and vectors.shape[1] != manifest.text.dimensions:
        expected = f"expected {manifest.text.dimensions}, as the network's features"
        raise ModelError(f"{path}: embeddings have {vectors.shape[1]} numbers, {expected}")
    return unit_vectors(vectors, str(path))


def _tokens(
    manifest: NetworkManifest, texts: Sequence[str], length: int | None
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the token ids (N, L) and the mask (N, L) of texts, of `length` or of the longest one."""
    assert manifest.prompts is not None  # nosec B101 # callers have asked
    try:
        from tokenizers import Tokenizer
    except ImportError as reason:
        raise ModelError("prompts need the package tokenizers; install it: pip install 'ltm[text]'") from reason
    path = manifest.file_of(manifest.prompts.tokenizer)
    try:
        tokenizer = Tokenizer.from_file(str(path))
        padding = tokenizer.padding or {}
        tokenizer.enable_truncation(length or _MOST_TOKENS)
        kept = {key: padding[key] for key in ("pad_id", "pad_token") if key in padding}
        tokenizer.enable_padding(length=length, **kept)
        found = tokenizer.encode_batch(list(texts))
    except Exception as reason:  # the library raises bare exceptions
        raise ModelError(f"{path}: not a usable tokenizer.json ({reason}); give that of the text encoder") from reason
    return np.array([one.ids for one in found], np.int64), np.array([one.attention_mask for one in found], np.int64)


def _digest(manifest: NetworkManifest, groups: _Groups) -> str:
    """Return the digest of all that the embeddings of prompts depend on."""
    found = hashlib.sha256(json.dumps([(name, *group) for name, group in groups.items()]).encode())
    prompts, text = manifest.prompts, manifest.text
    files = (prompts.tokenizer, prompts.encoder) if prompts is not None else ()
    for file in (*files, None if text is None else text.file):
        if file is not None:
            path = manifest.file_of(file)
            found.update(_file_digest(path, path.stat().st_mtime_ns).encode())
    return found.hexdigest()


@lru_cache(maxsize=8)
def _file_digest(path: Path, changed_ns: int) -> str:
    """Return the digest of a file, computed once per process: each camera has its segmenter, and encoders are large."""
    return NetworkFile.read(path).digest if path.suffix == ".onnx" else file_digest(path)
