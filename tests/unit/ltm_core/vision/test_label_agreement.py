import numpy as np
import pytest

from ltm_core.base.types import Float32Array
from ltm_core.label_heads.head_fit import fit_exponent
from ltm_core.vision.label_rules import LabelAgreement, agreed


def probabilities() -> Float32Array:
    """Three classes: the first left, the second right, and a patch of the third within the first; all at 0.8."""
    winner = np.zeros((60, 100), np.int64)
    winner[:, 60:] = 1
    winner[30:32, 20:22] = 2
    result = np.full((3, 60, 100), 0.1, np.float32)
    np.put_along_axis(result, winner[None], 0.8, axis=0)
    return result


def test_patches_and_edges_are_less_sure_than_the_middle_of_a_region() -> None:
    sure = agreed(probabilities(), LabelAgreement(reach=0.03))
    assert sure.shape == (60, 100)
    assert sure[5, 10] == pytest.approx(0.8, abs=1e-3)
    assert sure[50, 60] == pytest.approx(0.4, abs=0.08)
    assert sure[30, 20] < 0.1
    assert sure[30, 17] > 0.7
    np.testing.assert_allclose(
        agreed(probabilities(), LabelAgreement(reach=0.03, exponent=0.5)), np.sqrt(sure), atol=1e-6
    )


def test_the_exponent_makes_it_the_share_of_right_labels() -> None:
    rng = np.random.default_rng(4)
    sure = rng.uniform(0.05, 0.99, 20_000)
    right = rng.uniform(size=len(sure)) < sure**0.6
    nothing = np.zeros(0), np.zeros(0, np.bool_)
    assert fit_exponent([(sure, right), nothing]) == pytest.approx(0.6, abs=0.03)
    assert fit_exponent([nothing]) == 1.0
    few = sure[:2000], rng.uniform(size=2000) < sure[:2000] ** 1.8
    middle = fit_exponent([(sure, right), few])
    assert middle == pytest.approx(fit_exponent([(sure[:2000], right[:2000]), few]), abs=0.1)  # photos count alike
    assert 0.9 < middle < 1.3
