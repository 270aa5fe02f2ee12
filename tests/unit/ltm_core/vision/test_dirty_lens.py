"""A lens that becomes dirty, of a scene that is made: what is told, when, and when no more."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.vision.dirty_lens import (
    AGREEING,
    APART_S,
    COLUMNS,
    HISTORY_APART_S,
    LEAST_HISTORY,
    RELEARNT_AFTER_S,
    ROWS,
    DirtyLens,
)

WIDTH, HEIGHT = 240, 180


def scene(seed: int = 1) -> UInt8Array:
    """(H, W, 3): a smooth sky above ground with detail everywhere."""
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(rng.integers(60, 160, (12, 16)).astype(np.float32), (WIDTH, HEIGHT))
    grey = coarse + rng.normal(0.0, 14.0, (HEIGHT, WIDTH)).astype(np.float32)
    grey[: HEIGHT // 3] = np.linspace(200, 180, WIDTH)
    return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


class Camera:
    """Shows a scene in changing light to a `DirtyLens`."""

    def __init__(self) -> None:
        self.lens, self.now, self._rng = DirtyLens(), 0.0, np.random.default_rng(3)
        self.wet = np.zeros((HEIGHT, WIDTH), np.bool_)

    def take(self, count: int, apart_s: float = APART_S, view: int = 0) -> list[bool]:
        """Whether the lens is told after each of so many pictures."""
        told = []
        for _ in range(count):
            bright = np.clip(scene(view) * self._rng.uniform(0.7, 1.2), 0, 255).astype(np.float32)
            blurred = cv2.GaussianBlur(bright, (0, 0), 4.0)
            seen = np.where(self.wet[..., None], blurred, bright) + self._rng.normal(0.0, 1.0, bright.shape)
            self.lens.look(np.clip(seen, 0, 255).astype(np.uint8), view, self.now)
            self.now += apart_s
            told.append(bool(self.lens.said()))
        return told


def drop() -> BoolArray:
    """On the ground, to the lower left."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    return np.asarray((rows - 140) ** 2 + (columns - 50) ** 2 < 30**2, np.bool_)


@pytest.fixture
def camera() -> Camera:
    camera = Camera()
    assert not any(camera.take(LEAST_HISTORY, HISTORY_APART_S))
    assert not any(camera.take(AGREEING))
    return camera


def test_a_drop_is_told_when_enough_pictures_agree_and_no_more_when_it_is_gone(camera: Camera) -> None:
    camera.wet = drop()
    told = camera.take(AGREEING + 2)
    assert told.index(True) == round(0.9 * AGREEING) - 1
    assert "lower part, left" in camera.lens.said()
    assert "clean it" in camera.lens.said()
    rows, columns = np.nonzero(camera.lens.blurred)
    assert (rows.min(), columns.max()) >= (110 * ROWS // HEIGHT, 0)
    assert columns.max() <= 80 * COLUMNS // WIDTH
    camera.wet[:] = False
    told = camera.take(AGREEING)
    assert told[0]
    assert not any(told[AGREEING // 2 + 1 :])


def test_it_goes_on_being_told_and_what_is_blurred_is_not_learnt(camera: Camera) -> None:
    camera.wet = drop()
    camera.take(AGREEING)
    assert all(camera.take(40, HISTORY_APART_S))


def test_a_passing_cloud_on_the_ground_is_not_told(camera: Camera) -> None:
    for _ in range(3):
        camera.wet = drop()
        assert not any(camera.take(AGREEING // 2))
        camera.wet[:] = False
        assert not any(camera.take(AGREEING // 2))


def test_a_drop_before_the_sky_cannot_be_seen(camera: Camera) -> None:
    camera.wet = np.roll(drop(), -110, axis=0)
    assert not camera.wet[HEIGHT // 3 :].any()
    assert not any(camera.take(AGREEING))


def test_a_camera_that_nothing_is_known_of_says_nothing() -> None:
    camera = Camera()
    camera.wet = drop()
    assert not any(camera.take(AGREEING + LEAST_HISTORY))


@pytest.mark.parametrize("apart_s", [APART_S, APART_S / 5])
def test_the_drops_of_all_views_are_the_lenss_and_no_sooner_than_of_one(camera: Camera, apart_s: float) -> None:
    """Of a head that goes to three presets in turn, however fast: fog shall have as long to drift."""
    views = (0, 2, 3)
    for view in views[1:]:
        camera.take(LEAST_HISTORY, HISTORY_APART_S, view)
    camera.wet = drop()
    begun, told_after = camera.now, 0.0
    while not told_after:
        for view in views:
            if camera.take(1, apart_s, view)[0] and not told_after:
                told_after = camera.now - apart_s - begun
    pictures = round(0.9 * AGREEING)
    assert (pictures - 1) * APART_S <= told_after < (pictures + 1) * APART_S


def test_a_camera_whose_whole_picture_is_blurred_is_told(camera: Camera) -> None:
    camera.wet[:] = True
    assert camera.take(AGREEING)[-1]


def test_night_and_fog_say_nothing_of_the_lens(camera: Camera) -> None:
    for grey in (10, 190):
        camera.lens.look(np.full((HEIGHT, WIDTH, 3), grey, np.uint8), 0, camera.now)
        camera.now += APART_S
    camera.wet = drop()
    assert camera.take(AGREEING)[-1]


def test_what_nobody_cleans_for_a_week_is_learnt_anew(camera: Camera) -> None:
    camera.wet = drop()
    assert camera.take(AGREEING)[-1]
    camera.now += RELEARNT_AFTER_S
    assert not any(camera.take(LEAST_HISTORY + AGREEING, HISTORY_APART_S))


def test_a_picture_that_follows_too_soon_is_not_wanted() -> None:
    lens = DirtyLens()
    lens.look(scene(), 4, 100.0)
    assert [lens.wants(view, 100.0 + APART_S / 2) for view in (4, 5)] == [False, True]
    assert lens.wants(4, 100.0 + APART_S)


def test_another_shape_is_refused() -> None:
    with pytest.raises(ImageError, match="expected"):
        DirtyLens().look(np.zeros((90, 120), np.uint8), 0, 0.0)
