from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ltm_core.base.errors import ConfigError
from ltm_core.label_heads.labelled_frames import read_frames
from ltm_core.vision.areas import read_areas
from ltm_ros.labelling.server import LabelSession

WIDTH, HEIGHT = 60, 40


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(1)
    for name in ("a.png", "b.png"):
        Image.fromarray(rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)).save(tmp_path / name)
    return tmp_path


def square(name: str, left: int, top: int, right: int, bottom: int) -> dict[str, object]:
    return {"kind": "polygon", "name": name, "points": [[left, top], [right, top], [right, bottom], [left, bottom]]}


def saved(folder: Path, name: str) -> np.ndarray:
    with Image.open(folder / f"{name}_labels.png") as png:
        assert png.mode == "L"
        return np.asarray(png)


def test_areas_become_polygons_and_a_label_image(folder: Path) -> None:
    session = LabelSession(folder)
    shapes = [square("sky", 0, 0, 59, 19), square("tree", 10, 10, 30, 30), square("masked", 0, 0, 4, 39)]
    assert session.save(0, {"shapes": shapes}) == session.areas(0)
    labels = saved(folder, "a")
    expected = np.full((HEIGHT, WIDTH), 255, np.uint8)
    expected[:20], expected[10:31, 10:31], expected[:, :5] = 0, 3, 255
    np.testing.assert_array_equal(labels, expected)
    assert [area.kind for area in read_areas(folder / "polygons.json")] == ["sky", "tree", "masked"]
    assert [photo["areas"] for photo in session.overview()["photos"]] == [3, 0]
    again = LabelSession(folder)
    assert again.areas(0) == session.areas(0)
    assert [photo["name"] for photo in again.overview()["photos"]] == ["a.png", "b.png"], "label images are no photos"


def test_a_labelled_folder_is_read_as_truth(folder: Path) -> None:
    """With a mask and an erased place, as the page saves them; by its label images and by its areas alone."""
    session = LabelSession(folder)
    shapes = [square("tree", 0, 0, 59, 39), square("masked", 0, 0, 9, 9), square("unlabelled", 20, 20, 29, 29)]
    session.save(0, {"shapes": shapes})
    expected = np.full((HEIGHT, WIDTH), 3, np.uint8)
    expected[:10, :10] = expected[20:30, 20:30] = 255
    for _ in range(2):
        (frame,) = read_frames(folder, len(session.labels))
        np.testing.assert_array_equal(frame.labels, expected)
        (folder / "a_labels.png").unlink(missing_ok=True)


@pytest.mark.parametrize(
    "content",
    [
        [],
        {"shapes": 7},
        {"shapes": [square("volcano", 0, 0, 5, 5)]},
        {"shapes": [square("sky", 0, 0, 5, 5) | {"kind": "circle"}]},
        {"shapes": [{"kind": "polygon", "name": "sky", "points": [[0, 0], [1, 1]]}]},
        {"shapes": [{"kind": "stroke", "name": "sky", "points": [[0, 0]], "radius": 1e9}]},
        {"shapes": [{"kind": "stroke", "name": "sky", "points": [[0, 1e300]], "radius": 3}]},
        {"shapes": [square("sky", 0, 0, 5, 5)] * 5001},
        {"shapes": [square("sky", 0, 0, 5, 5)], "image": "../../etc/passwd"},
    ],
)
def test_what_is_no_list_of_areas_changes_nothing(folder: Path, content: object) -> None:
    session = LabelSession(folder)
    with pytest.raises(ConfigError):
        session.save(0, content)
    assert sorted(path.name for path in folder.iterdir()) == ["a.png", "b.png"]
