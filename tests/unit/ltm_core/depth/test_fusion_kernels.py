import numpy as np
import pytest
from scenes.called import called

from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.occlusion_prior import OcclusionPrior, mixture_moments, occlusion_log_odds
from ltm_core.depth.pixel_fusion import DecisionRules, FusionRow, average_row
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.vision.labels import Label, LabelSet

pytestmark = pytest.mark.kernel

CONFIG = FusionConfig()
RULES = DecisionRules.of(CONFIG.decision)


def plain_ground(rows: int = 120, columns: int = 200, focal: float = 150.0, height: float = 30.0) -> Float32Array:
    """Depth over a plain, seen level from `height` metres above: sky in the upper half."""
    below = np.arange(rows) - (rows - 1) / 2
    with np.errstate(divide="ignore"):
        depth = np.where(below > 0, focal * height / below, np.inf)
    return np.repeat(depth[:, None], columns, 1).astype(np.float32)


def standing_of(
    labels: UInt8Array | None, cells: tuple[int, int], pitch: float = 0.0, roll: float = 0.0
) -> OcclusionPrior:
    """Over that plain."""
    camera = Camera(200, 120, 150.0, 150.0, 99.5, 59.5)
    pose = Pose.from_angles((0.0, 0.0, 30.0), 20.0, pitch, roll)
    return OcclusionPrior.of(plain_ground(), labels, ClassPriors.of(LabelSet.load()), camera, pose, cells, CONFIG)


def odds_at(standing: OcclusionPrior, row: int, near: float, odds: float = 0.0) -> float:
    """Log odds of something at depth `near` metres, in the middle of a photo."""
    column = standing.feet[len(standing.feet) // 2]
    return float(called(occlusion_log_odds)(standing, np.float32(odds), np.float32(1 / near), column, row))


def test_the_higher_a_thing_would_have_to_be_the_less_likely_it_stands() -> None:
    """Over a plain, on which a thing at depth z has its foot `30 f / z` rows below the horizon."""
    standing = standing_of(None, (12, 20))
    # Something as high as the camera reaches up to the horizon, however far it is; rows are told by fours.
    for near in (100.0, 200.0, 400.0):
        foot = 59.5 + 150 * 30 / near
        for high in (0.0, 3.0, 12.0):
            row = int(foot - high * 150 / near)
            metre = odds_at(standing, row, near) - odds_at(standing, int(foot), near)
            assert metre == pytest.approx(-0.14 * high, abs=0.14 * (5 * near / 150))
    assert odds_at(standing, 100, 90.0, 2.0) == pytest.approx(odds_at(standing, 100, 90.0) + 2.0)


def test_the_label_of_a_place_gives_its_odds() -> None:
    """In a meadow nothing stands, in a wood it may; sky says nothing."""
    classes = ClassPriors.of(LabelSet.load())
    labels = np.full((120, 200), Label.GRASS, np.uint8)
    labels[:, 80:] = Label.TREE
    labels[:40] = Label.SKY
    odds = standing_of(labels, (24, 40)).odds
    for part, wanted in ((odds[8:, :16], classes.occluder_log_odds[int(Label.GRASS)]), (odds[:8], 0.0),
                         (odds[8:, 16:], classes.occluder_log_odds[int(Label.TREE)])):  # fmt: skip
        assert (part == wanted).all()
    unlabelled = standing_of(None, (24, 40)).odds
    assert np.unique(unlabelled).tolist() == [classes.occluder_log_odds[255]]


@pytest.mark.parametrize("likely", [0.25, 0.5, 0.7])
def test_a_depth_that_may_be_either_of_two_has_their_mean_and_all_of_their_spread(likely: float) -> None:
    """As many draws from both say."""
    rng = np.random.default_rng(4)
    draws = np.where(rng.random(400_000) < likely, rng.normal(90, 9, 400_000), rng.normal(700, 30, 400_000))
    mean, sigma = called(mixture_moments)(*np.array([700, 30, 90, 9, likely], np.float32))
    assert mean == pytest.approx(draws.mean(), rel=0.01)
    assert sigma == pytest.approx(draws.std(), rel=0.01)


def test_a_terrain_that_is_torn_between_two_depths_is_not_averaged() -> None:
    """What is unsure by a tenth is; the mean is that of inverse variances."""
    true = np.full(3, 1 / 500, np.float32)
    own = true * np.array([0.1, 0.1, 0.2], np.float32)
    off = true * np.array([0.05, 0.9, 0.05], np.float32)
    joint = own**2 + (0.1 * true) ** 2
    depth, sigma, kind = 1 / true, own / true**2, np.ones(3, np.uint8)
    none = np.empty(3, np.float32)
    row = FusionRow(
        depth, sigma, kind, kind, none, none, none, true, own, none, off, joint, none.copy(), np.ones(3, np.bool_)
    )
    called(average_row)(row, RULES)
    np.testing.assert_allclose(depth, [500 / 1.025, 500, 500], rtol=1e-5)
    np.testing.assert_allclose(sigma, [0.1 * np.sqrt(0.5) * 500 / 1.025**2, 50, 100], rtol=1e-4)
    np.testing.assert_array_equal(kind, [3, 1, 1])
