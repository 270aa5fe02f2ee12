import numpy as np
import pytest

from ltm_core.fuel.cell_appearance_model import SEEN, CellAppearanceModel, what_is_seen
from ltm_core.fuel.life_form import FORMS, LifeForm

TREE, SHRUB, GRASS = LifeForm.TREE - 1, LifeForm.SHRUB - 1, LifeForm.GRASS - 1


def one_hot(*forms: int) -> np.ndarray:
    return np.eye(FORMS)[list(forms)]


def test_neighbours_are_those_along_the_sight() -> None:
    """Three cells in a row from west to east and one south of the first; the sight goes east, then north."""
    rows, cols = np.array([4, 4, 4, 5]), np.array([7, 8, 9, 7])
    shares = one_hot(TREE, SHRUB, GRASS, LifeForm.BARE - 1)
    own, before, behind = slice(1, 8), slice(15, 22), slice(22, 29)
    east = what_is_seen(rows, cols, shares, np.full(4, np.pi / 2), None)
    assert east.shape == (4, SEEN)
    np.testing.assert_array_equal(east[:, own], shares)
    np.testing.assert_array_equal(east[:3, before], one_hot(TREE, TREE, SHRUB))  # the first one's is not seen
    np.testing.assert_array_equal(east[:3, behind], one_hot(SHRUB, GRASS, GRASS))
    north = what_is_seen(rows, cols, shares, np.zeros(4), np.array([0.7, 0.7, 0.7, 0.9]))
    np.testing.assert_array_equal(north[[0, 3]][:, before], one_hot(LifeForm.BARE - 1, LifeForm.BARE - 1))
    np.testing.assert_array_equal(north[[0, 3]][:, behind], one_hot(TREE, TREE))
    np.testing.assert_allclose(north[:, 8:15], shares * [[0], [0], [0], [0.2]], atol=1e-12)


def test_likelihood_between_two_incidences() -> None:
    weights = np.zeros((2, SEEN))
    weights[:, 1 + TREE] = 1.0, 3.0  # of the share of pixels called tree
    look = CellAppearanceModel(
        incidence=(0.1, 0.5), weights={"shrub": (0 * weights).tolist(), "tree": weights.tolist()}
    )
    seen = what_is_seen(np.array([3]), np.array([5]), one_hot(TREE), np.zeros(1), None)
    for cosine, expected in ((0.0, 1.0), (0.1, 1.0), (0.2, 1.5), (0.5, 3.0), (0.9, 3.0)):
        found = look.log_likelihood(seen, np.array([cosine]))[0]
        assert found[TREE] - found[SHRUB] == pytest.approx(expected)
        assert np.isneginf(np.delete(found, [SHRUB, TREE])).all()
