"""Map words of a user to classes of a network: the open-vocabulary query of the paper.

A network of kind `embeddings` answers words that its text file holds. Any other network knows a few classes; a word is
then read as one of them through `config/vocabulary.yaml`, and the reading says so.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ltm_core.base.errors import ConfigError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.storage.config_io import load_yaml
from ltm_core.vision.labels import UNLABELLED, LabelSet
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.segmenter import Segmenter
from ltm_core.vision.word_embeddings_io import load_text

_COLORS = (
    (222, 205, 95), (196, 120, 45), (30, 115, 55), (165, 150, 140), (35, 85, 190), (205, 50, 60), (150, 80, 170),
    (90, 180, 170), (240, 150, 180), (110, 110, 40), (60, 60, 120), (135, 190, 235),
)  # fmt: skip


class _VocabularyFile(StrictModel):
    synonyms: dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class Vocabulary:
    """Words and their labels."""

    synonyms: dict[str, tuple[str, ...]]

    @classmethod
    def load(cls, path: Path | None = None) -> Vocabulary:
        """Read a vocabulary file, by default the one that ships. Raises ConfigError, also for a word of two labels."""
        path = config_path("vocabulary.yaml") if path is None else path
        vocabulary = cls(load_yaml(path, _VocabularyFile).synonyms)
        seen: dict[str, str] = {}
        for label, words in vocabulary.synonyms.items():
            for word in words:
                if word in seen:
                    raise ConfigError(f"{path}: {word!r} is mapped to {seen[word]} and to {label}; give it one label")
                seen[word] = label
        return vocabulary

    @cached_property
    def label_of(self) -> dict[str, str]:
        """Return each known word and the label it stands for; labels stand for themselves."""
        words = {word: label for label, words in self.synonyms.items() for word in words}
        return words | {label: label for label in self.synonyms}


@dataclass(frozen=True)
class QueryMatch:
    """Match of one query: the network's classes for it, and the way it was found."""

    query: str
    classes: tuple[str, ...]
    how: str


def parse_queries(text: str) -> list[str]:
    """Return the comma-separated queries, trimmed, in lower case. Raises ConfigError for none, or one twice."""
    queries = [" ".join(part.lower().split()) for part in text.split(",")]
    queries = [query for query in queries if query]
    if not queries or len(set(queries)) != len(queries):
        raise ConfigError(
            f'classes {text!r}: expected words separated by commas, each once: "dry grass, chaparral, oak"'
        )
    return queries


def read_queries(queries: Sequence[str], manifest: NetworkManifest, vocabulary: Vocabulary) -> list[QueryMatch]:
    """Match each query to classes of a network. Raises ConfigError for a word unknown to both network and
    vocabulary."""
    words = load_text(manifest).names if manifest.text is not None else manifest.classes
    readings: list[QueryMatch] = []
    taken: dict[str, str] = {}
    for query in queries:
        reading = _read(query, words, manifest, vocabulary)
        free = tuple(name for name in reading.classes if name not in taken)
        how = reading.how
        if not free:
            rival = taken[reading.classes[0]]
            how += f"; so is {rival!r}, and all of it is reported as {rival!r}"
        taken.update(dict.fromkeys(free, query))
        readings.append(QueryMatch(query, free, how))
    return readings


def _read(query: str, words: Sequence[str], manifest: NetworkManifest, vocabulary: Vocabulary) -> QueryMatch:
    if query in words:
        return QueryMatch(query, (query,), f"is a word of {manifest.name}")
    if manifest.text is not None:
        close = ", ".join(difflib.get_close_matches(query, words, 4, 0.4)) or ", ".join(list(words)[:12])
        raise ConfigError(
            f"{query!r} is not among the {len(words)} words whose embeddings {manifest.name} has (similar: {close}); "
            "add its embedding to the text file"
        )
    for phrase, how in ((query, ""), (query.rpartition(" ")[2], " by its last word")):
        label = vocabulary.label_of.get(phrase)
        classes = tuple(name for name in manifest.classes if label is not None and manifest.mapping.get(name) == label)
        if classes:
            return QueryMatch(query, classes, f"is read as {label}{how}: {manifest.name} has no finer word")
        if label is not None:
            raise ConfigError(f"{query!r} means {label}, for which {manifest.name} has no class")
    known = sorted(vocabulary.label_of)
    close = ", ".join(difflib.get_close_matches(query, known, 4, 0.5)) or ", ".join(vocabulary.synonyms)
    raise ConfigError(f"unknown word {query!r}; similar words: {close} (see config/vocabulary.yaml)")


def open_vocabulary(
    manifest: NetworkManifest, queries: Sequence[str], threads: int = 1, vocabulary: Vocabulary | None = None
) -> tuple[Segmenter, list[QueryMatch]]:
    """Return a segmenter whose labels are the queries, in their order, and the match of each.

    Among a text network's words only the queries compete; another network's classes that answer no query stay
    unlabelled. Raises ConfigError for more than 255 queries and as `read_queries`; ModelError as Segmenter.
    """
    if len(queries) > UNLABELLED:
        raise ConfigError(f"{len(queries)} classes; a label image can have {UNLABELLED} at most")
    readings = read_queries(queries, manifest, Vocabulary.load() if vocabulary is None else vocabulary)
    labels = LabelSet(
        names=tuple(queries),
        colors=tuple(_COLORS[i % len(_COLORS)] for i in range(len(queries))),
        ground_cover=tuple(query != "sky" for query in queries),
    )
    mapping = {name: reading.query for reading in readings for name in reading.classes}
    words = queries if manifest.text is not None else None
    return Segmenter(manifest.model_copy(update={"mapping": mapping}), threads, labels, words), readings
