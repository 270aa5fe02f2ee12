import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scenes.small_site import write_small_site

from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.frame_steps import LabellingConfig, LabellingStep
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.segmenter import Segmentation
from ltm_core.vision.smoke import APART_S, OLDEST_S, REMEMBERED, WORKING_WIDTH, SmokeMemory

SIZE = (216, 384)
SKYLINE = 70


def labels() -> UInt8Array:
    found = np.full(SIZE, Label.SHRUB, np.uint8)
    found[:SKYLINE] = Label.SKY
    return found


def land(seed: int = 1) -> UInt8Array:
    """A slope with a pattern of bushes below a plain sky."""
    rng = np.random.default_rng(seed)
    grey = cv2.GaussianBlur(rng.normal(0, 1, SIZE).astype(np.float32), (0, 0), 2.0)
    grey = 95 + 14 * grey / grey.std()
    grey[:SKYLINE] = 190
    return np.repeat(np.clip(grey, 0, 255)[..., None], 3, axis=2).astype(np.uint8)


def plume(picture: UInt8Array, seed: int, opaque: float = 0.97) -> tuple[UInt8Array, BoolArray]:
    """With pale smoke of its own soft pattern before the slope and the sky; where it is."""
    rows, cols = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    there = ((rows - 90) / 55.0) ** 2 + ((cols - 250) / 50.0) ** 2 < 1
    soft = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, SIZE).astype(np.float32), (0, 0), 8.0)
    smoke = 175 + 6 * soft / soft.std()
    mixed = picture.astype(np.float32)
    mixed[there] = (1 - opaque) * mixed[there] + opaque * smoke[there][:, None]
    return mixed.astype(np.uint8), there


def after(before: list[UInt8Array], picture: UInt8Array, at_s: float = APART_S) -> BoolArray | None:
    memory = SmokeMemory()
    for number, earlier in enumerate(before):
        memory.look(earlier, labels(), number * APART_S)
    return memory.look(picture, labels(), (len(before) - 1) * APART_S + at_s)


def test_smoke_before_the_land_is_told_and_the_land_beside_it_is_not() -> None:
    picture, there = plume(land(), 2)
    found = after([land()], picture)
    assert found is not None
    hidden = there & (labels() != Label.SKY)
    beside = cv2.dilate(there.astype(np.uint8), np.ones((45, 45), np.uint8)) == 0
    assert found[hidden].mean() > 0.9
    assert not found[beside].any()


def test_nothing_is_told_of_a_first_picture_nor_by_one_that_is_too_young_or_too_old() -> None:
    picture, _ = plume(land(), 2)
    assert SmokeMemory().look(picture, labels(), 0.0) is None
    assert after([land()], picture, APART_S - 1) is None
    assert after([land()], picture, OLDEST_S + 1) is None
    assert after([land()], picture, OLDEST_S - 1) is not None


def test_another_light_another_view_and_the_shade_of_a_cloud_are_no_smoke() -> None:
    darker = (land() * 0.6 + 8).astype(np.uint8)
    assert after([land()], darker) is None
    assert after([darker], land()) is None
    assert after([land()], land(seed=9)) is None
    shade = land()
    shade[100:180, 50:200] = (shade[100:180, 50:200] * 0.5).astype(np.uint8)
    assert after([land()], shade) is None
    assert after([land(), shade], land()) is None


def test_a_felled_stand_is_land_again_once_it_was_seen_and_moving_smoke_stays_smoke() -> None:
    felled = land()
    felled[110:170, 60:160] = np.clip(land(seed=5)[110:170, 60:160].astype(int) + 60, 0, 255).astype(np.uint8)
    assert after([land(), land()], felled) is not None
    assert after([land(), land(), felled], felled) is None
    assert after([land(), plume(land(), 2)[0], plume(land(), 3)[0]], plume(land(), 4)[0]) is not None


def test_of_a_patrol_the_pictures_of_the_same_view_are_compared() -> None:
    views = [land(seed) for seed in (1, 2, 3, 1, 2, 3)]
    picture, there = plume(land(2), 7)
    found = after(views, picture)
    assert found is not None
    assert found[there & (labels() != Label.SKY)].mean() > 0.9
    assert after(views, land(2)) is None


def test_pictures_without_a_pattern_leave_room_for_what_was_seen_before() -> None:
    """Fog at a frame a second, for ten minutes."""
    memory, fog = SmokeMemory(), np.full((*SIZE, 3), 170, np.uint8)
    memory.look(land(), labels(), 0.0)
    for second in range(1, 601, 5):
        memory.look(fog, labels(), float(second))
    assert memory.look(plume(land(), 2)[0], labels(), 700.0) is not None


def test_what_it_will_hold_in_three_hours_it_holds_from_the_first_picture_on() -> None:
    memory = SmokeMemory()
    small = round(WORKING_WIDTH * SIZE[0] / SIZE[1]) * WORKING_WIDTH
    tracemalloc.start()
    memory.look(land(), labels(), 0.0)
    first, _ = tracemalloc.get_traced_memory()
    for number in range(1, 2 * REMEMBERED):
        memory.look(land(number % 3), labels(), number * APART_S)
    last, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # Grey levels, a bit for land, and a sixteenth of the pixels as numbers of four bytes.
    taken = REMEMBERED * small * (1 + 1 / 8 + 4 / 16)
    assert taken <= first < taken + 50_000
    assert last < first + 50_000


def test_a_camera_may_be_judged_without_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = write_small_site(tmp_path, recording=False)
    content = yaml.safe_load(small.path.read_text())
    picture, there = plume(land(), 2)
    hidden = there & (labels() != Label.SKY)
    gone = {}
    for judged in (True, False):
        content["expert"] = {"cameras": {"mast": {"judge_smoke": judged}}}
        small.path.write_text(yaml.safe_dump(content))
        step = LabellingStep(load_site(small.path), "mast", LabellingConfig())
        monkeypatch.setattr(step.segmenter, "segment", lambda *_: Segmentation(labels(), np.full(SIZE, 200, np.uint8)))
        camera, pose = Camera.from_fov(SIZE[1], SIZE[0], 60.0), Pose.from_angles((0.0, 0.0, 0.0), 0.0)
        step.label(PosedImage(land(), camera, pose, 0, "mast"), np.eye(6))
        found, view = step.label(PosedImage(picture, camera, pose, int(APART_S * 1e9), "mast"), np.eye(6))
        gone[judged] = float((found.labels == UNLABELLED)[hidden].mean()), view.smoke
    assert gone[True][0] > 0.9
    assert gone[True][1] > 0.02
    assert gone[False] == (0.0, 0.0)
