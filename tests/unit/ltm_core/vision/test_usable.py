import cv2
import numpy as np
import pytest
from scenes.tower_pictures import HEIGHT, HORIZON, WIDTH, corners, tower_picture

from ltm_core.base.types import UInt8Array
from ltm_core.vision.scene_view import SceneFilter, SceneView
from ltm_core.vision.usable import COLUMNS, ROWS, Unusable, judge


def clear() -> UInt8Array:
    return tower_picture(3, hood=False, caption="")


def spoilt(way: str) -> UInt8Array:
    photo, rng = clear().astype(np.float32), np.random.default_rng(2)
    if way == "night":
        photo = 0.07 * photo + rng.normal(2.0, 2.0, photo.shape)
    elif way == "dusk":
        photo = 0.5 * photo
    elif way == "fog":
        photo = 0.05 * photo + 175.0
    elif way == "glare":
        photo[: 3 * HEIGHT // 4] = 255.0
    elif way == "blur":
        photo = cv2.GaussianBlur(photo, (0, 0), 0.008 * WIDTH)
    else:
        photo[:] = (0.0, 128.0, 0.0)
    return np.clip(photo, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("reason", list(Unusable))
def test_each_way_to_be_of_no_use_is_told(reason: Unusable) -> None:
    found = judge(spoilt(reason), sun_deg=2.0)
    assert found.reason is reason
    assert found.said.startswith(f"{reason}: ")


def test_dusk_is_a_low_sun_and_a_dim_picture() -> None:
    """A dark forest is dim at noon, and a camera may make up for the light of the evening."""
    dim = spoilt("dusk")
    assert [judge(dim, sun_deg=sun).reason for sun in (30.0, None, -9.0)] == [None, None, Unusable.DUSK]
    assert judge(clear(), sun_deg=2.0).reason is None


@pytest.mark.parametrize("colours", [(1.0, 1.0, 1.0), (1.0, 0.75, 0.4)], ids=["infrared", "floodlit"])
def test_a_lit_foreground_below_a_black_sky_is_night_but_not_by_day(colours: tuple[float, ...]) -> None:
    photo = np.where(np.arange(HEIGHT)[:, None, None] < HORIZON, 0.08, 2.5) * clear().mean(axis=2, keepdims=True)
    lit = np.clip(photo * colours, 0, 255).astype(np.uint8)
    assert [judge(lit, sun_deg=sun).reason for sun in (None, -20.0, 30.0)] == [Unusable.NIGHT, Unusable.NIGHT, None]


def test_how_high_the_sun_stood_is_told_by_stamp_and_place() -> None:
    at_greenwich = SceneFilter(place=(0.0, np.radians(51.5)))
    noon, evening = (int(np.datetime64(f"2026-06-21T{hour}", "ns").astype(np.int64)) for hour in ("12:00", "20:00"))
    found = {stamp: at_greenwich.look(spoilt("dusk"), stamp_ns=stamp).reason for stamp in (noon, evening, None)}
    assert found == {noon: None, evening: Unusable.DUSK, None: None}
    nowhere = SceneFilter()
    assert nowhere.look(spoilt("dusk"), stamp_ns=evening).reason is None


def test_what_is_masked_has_no_say() -> None:
    """A black hood over most of a picture: black as by night, were it not masked."""
    photo = clear()
    hidden = np.ones((HEIGHT, WIDTH), np.bool_)
    hidden[HORIZON - 40 : HORIZON + 60, 200:420] = False
    photo[hidden] = 0
    assert judge(photo).doubtful.mean() > 0.7
    found = judge(photo, hidden)
    assert found.reason is None
    assert not found.doubtful.any()
    assert judge(photo, np.ones_like(hidden)).reason is Unusable.BLANK
    assert judge(tower_picture(3), corners()).reason is None


def test_burnt_out_and_black_regions_are_doubtful_and_lose_land_not_sky() -> None:
    photo = clear()
    photo[HORIZON + 40 :, 600:] = 255
    photo[HORIZON + 40 :, :150] = 3
    photo[:60, :300] = 255
    found = judge(photo)
    assert found.reason is None
    assert found.doubtful.shape == (ROWS, COLUMNS)
    assert found.doubtful[-2, -2:].all()
    assert found.doubtful[-2, :2].all()
    assert not found.doubtful[-2, 4:8].any()
    labels = np.where(np.arange(HEIGHT)[:, None] < HORIZON, 0, 3).astype(np.uint8) * np.ones((1, WIDTH), np.uint8)
    confidence = np.full(labels.shape, 200, np.uint8)
    SceneView(None, found).unlabelled(labels, confidence)
    assert (labels[: HORIZON - 5] == 0).all(), "a burnt out sky is sky all the same"
    assert (labels[-60:-10, 640:] == 255).all()
    assert (labels[-60:-10, :120] == 255).all()
    assert (labels[-60:-10, 260:500] == 3).all()
    np.testing.assert_array_equal(confidence == 0, labels == 255)
