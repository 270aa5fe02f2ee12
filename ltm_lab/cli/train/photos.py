"""`ltm-lab train photos`: labels real photos with teacher networks, to train on."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.storage.image_io import read_rgb
from ltm_lab.options import writable_folder

if TYPE_CHECKING:
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.training.photo_sets import Opinions

_AREAS_WIDTH = 640
"""Maximum width in pixels of photos with areas: what the network is given."""
BY_HAND = "_by_hand"
"""Ends the name of a set whose labels are a person's alone: boxes of held-out photos."""


def photos(
    config: Annotated[
        Path, typer.Argument(help="Photos and what their slopes carry (mountain_photos.yaml), or landscape_photos.csv.")
    ],
    images: Annotated[Path, typer.Option(help="Folder of the photos.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for the sets of labelled photos.", callback=writable_folder)
    ],
    sky_model: Annotated[str, typer.Option(help="Network that knows sky.")] = "skyseg_u2netp",
    scene_model: Annotated[str, typer.Option(help="Network that knows near scenes.")] = "mosaic_r4_ade20k31",
    depth_model: Annotated[str, typer.Option(help="Network whose order of near and far is learnt.")] = "tcmonodepth",
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 2,
) -> None:
    """Label the photos of CONFIG with teachers and write each to OUT/<set>/: picture, labels, order of depth.

    Of a CSV such as landscape_photos.csv, write the labelled regions and areas (landscape_labels.zip and
    landscape_areas.json) and the statements about whole photos into the sets `areas_train` and `areas_validate`.
    """
    import cv2
    import numpy as np
    from rich.progress import track

    from ltm_core.base.errors import ImageError
    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.geometry.camera import Camera
    from ltm_core.storage.config_io import load_yaml
    from ltm_core.vision.labels import UNLABELLED
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.training.photo_sets import PhotoSets, teach

    if config.suffix == ".csv":
        _write_areas(config, images, out)
        return
    sets = load_yaml(config, PhotoSets)
    sky, scene = Segmenter.open(sky_model, threads), Segmenter.open(scene_model, threads)
    depth = DepthNetwork.open(depth_model, threads)
    width, height = sets.size
    camera = Camera.from_fov(width, height, 50.0)  # a relative depth does not look at it
    for name, tag in track(sets.photos.items(), "labelling photos"):
        path = next((p for p in (images / f"{name}{end}" for end in (".jpg", ".jpeg", ".png")) if p.is_file()), None)
        if path is None:
            raise ImageError(f"{images}: no photo {name}.jpg or .png, which {config} names")
        picture = read_rgb(path)
        photo = np.asarray(cv2.resize(picture, sets.size, interpolation=cv2.INTER_AREA), np.uint8)
        opinions = _opinions(sky, scene, picture, sets.size)
        labels, by_hand = teach(photo, opinions, tag), sets.by_hand(name)
        labels = np.where(by_hand == UNLABELLED, labels, by_hand)
        order = cv2.resize(depth.predict(photo, camera).values, sets.size, interpolation=cv2.INTER_LINEAR)
        order[opinions.sky > 0.25] = np.nan
        part = sets.set_of(name)
        _write(out / part / name, photo, labels)
        np.savez_compressed(out / part / f"{name}_order.npz", inverse=order.astype(np.float32))
        if part in sets.held_out and name in sets.boxes:
            _write(out / f"{part}{BY_HAND}" / name, photo, by_hand)
    print(f"{len(sets.photos)} photos in {out}")


def _write(base: Path, photo: UInt8Array, labels: UInt8Array) -> None:
    import cv2

    base.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(f"{base}.jpg", photo[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])
    cv2.imwrite(f"{base}_labels.png", labels)


def _write_areas(table: Path, images: Path, out: Path) -> None:
    import cv2
    import numpy as np

    from ltm_core.vision.overlays import scene_of
    from ltm_lab.evaluation.segmentation.area_score import listed_photos, regions
    from ltm_lab.training.training_frames import STATEMENT_SUFFIX

    for role in ("train", "validate"):
        for photo in listed_photos(role, table):
            image = scene_of(photo.read(images))
            scale = min(1.0, _AREAS_WIDTH / image.shape[1])
            image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
            height, width = image.shape[:2]
            labels = regions(table, photo.name, height, width)
            for index, (label, _) in enumerate(photo.areas):
                labels[photo.drawn(index, height, width) > 0] = label
            _write(out / f"areas_{role}" / photo.name, image, labels)
            if photo.absent:
                (out / f"areas_{role}" / f"{photo.name}{STATEMENT_SUFFIX}").write_text(photo.absent, encoding="utf-8")


def _opinions(sky: "Segmenter", scene: "Segmenter", photo: UInt8Array, size: tuple[int, int]) -> "Opinions":
    import cv2
    import numpy as np

    from ltm_core.vision.labels import Label
    from ltm_lab.training.photo_sets import Opinions

    def at_size(plane: Float32Array) -> Float32Array:
        return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR), np.float32)

    probabilities, mapping = scene.class_probabilities(photo), scene.manifest.mapping
    by_label: dict[Label, Float32Array] = {}
    for name, probability in probabilities.items():
        label = mapping.get(name, "unlabelled").upper()
        if label in Label.__members__:
            by_label[Label[label]] = by_label.get(Label[label], np.zeros_like(probability)) + probability
    scene_sky = by_label.pop(Label.SKY)
    return Opinions(
        sky=at_size(sky.class_probabilities(photo)["sky"]),
        scene_sky=at_size(scene_sky),
        slope=at_size(probabilities["mountain"]),
        classes={label: at_size(plane) for label, plane in by_label.items()},
    )
