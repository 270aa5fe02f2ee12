import numpy as np
import pytest
from scenes.tower_pictures import HEIGHT, WIDTH, corners, tower_picture

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray
from ltm_core.vision.areas import NamedArea
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.mask_proposals import Proposal, drawn_proposals, propose_mask


@pytest.fixture(scope="module")
def found() -> list[Proposal]:
    return propose_mask([tower_picture(seed) for seed in (1, 2, 3)])


def of(kind: str, proposals: list[Proposal]) -> BoolArray:
    parts = [p.hidden for p in proposals if p.kind == kind]
    return np.logical_or.reduce(parts) if parts else np.zeros((HEIGHT, WIDTH), np.bool_)


def test_the_corners_of_the_lens(found: list[Proposal]) -> None:
    lens, truth = of("lens", found), corners()
    assert (lens & truth).sum() > 0.95 * truth.sum()
    # Wider by a penumbra, no more.
    assert (lens & ~truth).sum() < 0.02 * truth.size


def test_the_caption_of_every_time(found: list[Proposal]) -> None:
    (caption,) = (p.hidden for p in found if p.kind == "caption")
    rows, cols = np.flatnonzero(caption.any(axis=1)), np.flatnonzero(caption.any(axis=0))
    assert rows[0] <= 7
    assert 18 <= rows[-1] <= 32
    assert cols[0] <= 121
    assert 380 < cols[-1] < 480
    yellow = np.asarray(tower_picture(1)).astype(int)
    letters = (yellow[..., 0] > 180) & (yellow[..., 2] < 110) & (np.arange(HEIGHT)[:, None] < 40)
    assert caption[letters].mean() > 0.99


def test_a_plain_picture_has_nothing_to_hide() -> None:
    frames = [tower_picture(seed, mast=False, hood=False, caption="") for seed in (1, 2, 3)]
    assert propose_mask(frames) == []


def test_pictures_of_two_sizes_are_not_of_one_camera() -> None:
    with pytest.raises(ImageError, match="800 x 520"):
        propose_mask([tower_picture(1), tower_picture(2)[:-8]])
    with pytest.raises(ImageError, match="there are none"):
        propose_mask([])


def test_what_is_drawn_or_erased_later_is_no_part_of_a_drawn_mask() -> None:
    def area(kind: str, left: int, right: int, image: str = "a.jpg") -> NamedArea:
        return NamedArea(image=image, kind=kind, polygon=((left, 5), (right, 5), (right, 20), (left, 20)))

    areas = [area("tree", 0, 39), area("masked", 10, 29), area("unlabelled", 25, 34), area("shrub", 5, 12)]
    areas += [area("unlabelled", 15, 18, "b.jpg"), area("masked", 32, 33), area("unlabelled", 30, 39)]
    (found,) = drawn_proposals(areas, LabelSet.load().names, (30, 40))
    expected = np.zeros((30, 40), np.bool_)
    expected[5:21, 13:25] = True
    np.testing.assert_array_equal(found.hidden, expected)
    assert found.kind == "masked"
