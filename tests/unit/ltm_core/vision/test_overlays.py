from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes.overlays import FRAMES, MASKED
from scenes.small_site import write_small_site
from scenes.tower_pictures import HEIGHT, HORIZON, WIDTH, tower_picture

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.frame_steps import LabellingConfig, LabellingStep
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import UNLABELLED
from ltm_core.vision.overlays import fill_hidden, find_overlay, scene_of
from ltm_core.vision.scene_view import SceneFilter


@cache
def _clear(seed: int) -> UInt8Array:
    return tower_picture(seed, hood=False, caption="")


def clear(seed: int = 3) -> UInt8Array:
    return _clear(seed).copy()


def compressed(photo: UInt8Array) -> UInt8Array:
    _, data = cv2.imencode(".jpg", photo[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 75])
    return np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1], np.uint8)


@pytest.mark.parametrize("stored", [np.asarray, compressed], ids=["exact", "JPEG"])
@pytest.mark.parametrize("kind", FRAMES)
def test_bars_and_frames(kind: str, stored: Callable[[UInt8Array], UInt8Array]) -> None:
    drawn, truth = FRAMES[kind](clear())
    found = find_overlay(stored(drawn))
    assert found is not None
    assert (found & truth).sum() > 0.97 * truth.sum()
    grown = cv2.dilate(truth.astype(np.uint8), np.ones((13, 13))) > 0
    assert not (found & ~grown).any()


def spoilt(way: str) -> UInt8Array:
    photo, rng = clear().astype(np.float32), np.random.default_rng(5)
    noise = rng.normal(0.0, 1.5, photo.shape)
    if way == "night":
        photo = 0.02 * photo + noise
    elif way == "dark foreground":
        edge = HEIGHT - 60 + 4 * np.sin(np.arange(WIDTH) / 40.0) + rng.normal(0.0, 1.5, WIDTH)
        photo[np.arange(HEIGHT)[:, None] > edge] *= 0.05
    elif way == "snow":
        photo[HORIZON:] = 0.05 * photo[HORIZON:] + 235 + noise[HORIZON:]
    elif way == "fog":
        photo = 0.03 * photo + 220 + noise
    elif way == "overexposed sky":
        photo[:HORIZON] = 255.0
    elif way == "black slope":
        rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
        photo[rows > HEIGHT - 30 + 0.03 * columns] = 0.0
    elif way == "one colour":
        photo[:] = 90.0
    return np.clip(photo, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    "way", ["day", "night", "dark foreground", "snow", "fog", "overexposed sky", "black slope", "one colour"]
)
def test_landscapes_have_none(way: str) -> None:
    photo = spoilt(way)
    assert find_overlay(photo) is None
    assert scene_of(photo) is photo


@pytest.mark.parametrize("width", [320, 1283])
def test_a_hole_continues_its_surroundings(width: int) -> None:
    rows, columns = np.mgrid[0:240, 0:width]
    photo = np.stack([rows, 255 * columns // width, np.full_like(rows, 77)], axis=-1).astype(np.uint8)
    hidden = (abs(rows - 120) < 20) & (abs(columns - width // 2) < 20)
    hidden[200:, width - 30 :] = True
    filled = fill_hidden(np.where(hidden[..., None], np.uint8(255), photo), hidden)
    np.testing.assert_array_equal(filled[~hidden], photo[~hidden])
    assert np.abs(filled.astype(int) - photo)[:199].max() <= 12
    assert np.abs(filled.astype(int) - photo)[..., 2].max() <= 1
    everywhere = np.ones_like(hidden)
    assert fill_hidden(photo, everywhere) is photo


@pytest.mark.parametrize("kind", [*FRAMES, *MASKED])
def test_the_scene_alone_is_judged_and_given_to_networks(kind: str) -> None:
    drawn, truth = (FRAMES | MASKED)[kind](clear())
    view = SceneFilter((lambda width, height: truth) if kind in MASKED else None).look(drawn)
    assert view.hidden is not None
    assert view.reason is None
    seen, grown = view.scene(drawn), cv2.dilate(view.hidden.astype(np.uint8), np.ones((3, 3))) > 0
    np.testing.assert_array_equal(seen[~grown], clear()[~grown])
    # The overlay's own colours are gone: what is filled lies near the photo below it.
    apart = np.abs(cv2.blur(seen, (31, 31)).astype(int) - cv2.blur(clear(), (31, 31)))
    before = np.abs(cv2.blur(drawn, (31, 31)).astype(int) - cv2.blur(clear(), (31, 31)))
    assert apart[truth].mean() < 0.5 * before[truth].mean()


def test_labels_are_those_of_the_scene_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = load_site(write_small_site(tmp_path, recording=False).path)
    step, given = LabellingStep(site, "tower", LabellingConfig()), []
    segment = step.segmenter.segment
    monkeypatch.setattr(step.segmenter, "segment", lambda photo, *_: given.append(photo) or segment(photo))
    drawn, truth = FRAMES["black above"](clear())
    camera = Camera.from_fov(drawn.shape[1], drawn.shape[0], 60.0)
    found, view = step.label(PosedImage(drawn, camera, Pose.from_angles((0.0, 0.0, 0.0), 0.0), 0, "tower"), np.eye(6))
    np.testing.assert_array_equal(given[0], view.scene(drawn))
    assert (found.labels[truth] == UNLABELLED).all()
    seen = ~view.hidden
    np.testing.assert_array_equal(found.labels[seen], segment(view.scene(drawn)).labels[seen])
