"""Sections of photos without a pose: labels alone, against what people have said of them."""

import math
from collections.abc import Callable
from pathlib import Path

from ltm_core.scoring.labels import SegmentationScore
from ltm_core.vision.labels import Label
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.gallery.exhibit import Exhibit, Fact, Section
from ltm_lab.evaluation.gallery.label_facts import facts_of_areas, facts_of_score, share_called, whole_picture
from ltm_lab.evaluation.gallery.real_photos_io import NamedPhoto, read_mountains, read_towers

Progress = Callable[[str], None]


def tower_section(data: Path, segmenter: Segmenter, progress: Progress) -> Section:
    """All photos of fire-watch towers. Raises LtmError where one cannot be read."""
    photos = read_towers(data)
    exhibits = tuple(_exhibit(photo, segmenter, progress) for photo in photos)
    return Section(
        "Fire-watch towers",
        "All photos of the folder.",
        "wrong, of the land named by hand",
        "Cameras of the HPWREN network over Californian chaparral (UC San Diego; CC BY-NC-SA), which no network that "
        "ships was trained on. A person has named areas in some of them, only where it was certain; boxes, captions "
        "and the words on smoke were drawn in by others. Poses are known to ten degrees, so nothing is traced.",
        exhibits,
        _together(exhibits, segmenter),
    )


def mountain_section(data: Path, segmenter: Segmenter, progress: Progress) -> Section:
    """The mountain photos that the rule takes. Raises LtmError where one cannot be read."""
    exhibits = tuple(_exhibit(photo, segmenter, progress) for photo in read_mountains(data))
    return Section(
        "Mountain photos",
        "Every second of the 30 photos that train no network (`photos_test`), in the order of the training file.",
        "wrong, of the land named by hand; where there are none, mountain that is called sky",
        "Photos from Unsplash, brought to a square by their source, without a place. 187 others of the same set taught "
        "the default network, so these are easier for it than another mountain.",
        exhibits,
        _together(exhibits, segmenter),
    )


def _exhibit(named: NamedPhoto, segmenter: Segmenter, progress: Progress) -> Exhibit:
    progress(named.name)
    labels = segmenter.segment(named.photo).labels
    facts, fault = [whole_picture(labels, segmenter.labels)], float("nan")
    if named.mountain is not None:
        fault = share_called(labels, named.mountain, (Label.SKY,))
        facts.append(Fact("mountain that is called sky", fault, "%"))
    if named.truth is not None:
        of_areas, wrong = facts_of_areas(labels, named.truth, segmenter.labels.names)
        facts += of_areas
        fault = wrong if math.isfinite(wrong) else fault
    return Exhibit(named.name, named.photo, labels, tuple(facts), fault, named.truth)


def _together(exhibits: tuple[Exhibit, ...], segmenter: Segmenter) -> tuple[Fact, ...]:
    """Of all areas that are named by hand, pixel by pixel."""
    names, score = segmenter.labels.names, SegmentationScore.empty(len(segmenter.labels))
    judged = [shown for shown in exhibits if shown.truth is not None]
    for shown in judged:
        assert shown.truth is not None  # nosec B101 # tells the type checker what holds
        score = score.plus(shown.truth, shown.labels)
    facts = [Fact("photos", len(exhibits)), Fact("photos with areas named by hand", len(judged))]
    return (*facts, *facts_of_score(score, names)) if judged else tuple(facts)
