"""Writes the gallery of real photos: a page, and a sheet of pictures for each photo, all of one size."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.types import RgbImage
from ltm_core.pictures import (
    RangeScale,
    depth_colors,
    label_legend,
    overlay_depth,
    overlay_labels,
    panel,
    range_legend,
    to_jpeg,
    with_legend,
)
from ltm_core.pictures.legend import Palette
from ltm_core.vision.labels import UNLABELLED, LabelSet
from ltm_lab.evaluation.gallery.exhibit import Exhibit, Section
from ltm_ros.pages import render_page

PAGE, PICTURES = "gallery.html", "pictures"
_COLUMNS, _WIDTH = 2, 900
_JUDGED = Palette(("right", "wrong"), ((30, 138, 66), (208, 52, 38)))


def write_gallery(out: Path, data: Path, sections: Sequence[Section], networks: Sequence[str]) -> Path:
    """Write the page into `out`, its pictures beside it in `pictures`; the page's path."""
    labels = LabelSet.load()
    (out / PICTURES).mkdir(parents=True, exist_ok=True)
    shown = []
    for section in sections:
        exhibits = []
        for exhibit in section.worst_first():
            file = f"{PICTURES}/{_file_name(section, exhibit.name)}"
            (out / file).write_bytes(to_jpeg(sheet_of(exhibit, labels), 88))
            exhibits.append((exhibit, file))
        sheets = []
        for number, (title, sheet) in enumerate(section.sheets, start=1):
            file = f"{PICTURES}/{_file_name(section, f'change_{number}')}"
            (out / file).write_bytes(to_jpeg(sheet, 92))
            sheets.append((title, file))
        shown.append((section, exhibits, sheets))
    page = out / PAGE
    content = render_page(
        PAGE,
        {},
        "ltm_lab.evaluation",
        title="Gallery of real photos",
        sections=shown,
        data=str(data),
        networks=", ".join(networks),
    )
    page.write_text(content, encoding="utf-8")
    return page


def sheet_of(exhibit: Exhibit, labels: LabelSet) -> RgbImage:
    """All pictures of one photo, side by side: photo, labels, what is wrong with them, traced and fused depth."""
    photo = exhibit.photo
    every = np.unique(exhibit.labels).tolist()
    pictures: list[tuple[str, RgbImage]] = [
        ("photo", photo),
        (
            "labels",
            with_legend(overlay_labels(photo, exhibit.labels, labels), label_legend(photo.shape[1], labels, every)),
        ),
    ]
    if exhibit.truth is not None:
        known = exhibit.truth != UNLABELLED
        judged = np.where(known, exhibit.truth != exhibit.labels, UNLABELLED).astype(np.uint8)
        picture = overlay_labels(photo, judged, _JUDGED, 0.6)
        pictures.append(
            ("labels, where the truth is known", with_legend(picture, label_legend(photo.shape[1], _JUDGED)))
        )
    if exhibit.traced is not None and exhibit.fused is not None:
        scale = RangeScale.of(exhibit.traced)
        legend = range_legend(photo.shape[1], scale)
        pictures.append(
            ("traced depth over the photo", with_legend(overlay_depth(photo, exhibit.traced, scale), legend))
        )
        pictures.append(("traced depth: sky and unknown too", with_legend(depth_colors(exhibit.traced, scale), legend)))
        fused = depth_colors(exhibit.fused.depth, scale)
        pictures.append((f"fused depth: {exhibit.fused.verdict}", with_legend(fused, legend)))
    return panel(pictures, _COLUMNS, _WIDTH)


def figures_of(sections: Sequence[Section]) -> dict[str, Any]:
    """Everything that was measured, for a JSON file."""
    return {
        section.title: {
            "rule": section.rule,
            "fault": section.fault,
            "facts": [asdict(fact) for fact in section.facts],
            "photos": {
                shown.name: {"fault": shown.fault, "facts": [asdict(fact) for fact in shown.facts]}
                for shown in section.worst_first()
            },
        }
        for section in sections
    }


def _file_name(section: Section, name: str) -> str:
    return f"{section.title.lower().replace(' ', '_').replace('-', '_')}_{name}.jpg"
