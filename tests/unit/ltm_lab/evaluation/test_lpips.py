import io
import pickle
from pathlib import Path

import numpy as np
import pytest

from ltm_core.base.errors import ModelError
from ltm_lab.evaluation.sim2real.perceptual_io import load_arrays


def test_a_pickle_of_anything_else_is_refused(tmp_path: Path) -> None:
    tree = {"a": {"b": np.arange(6, dtype=np.float32).reshape(2, 3)}}
    found = load_arrays(io.BytesIO(pickle.dumps(tree)), tmp_path)
    np.testing.assert_array_equal(found["a"]["b"], tree["a"]["b"])
    for evil in (Path, np.load, print):
        with pytest.raises(ModelError, match="not a pickle of NumPy arrays alone"):
            load_arrays(io.BytesIO(pickle.dumps(evil)), tmp_path)
    with pytest.raises(ModelError):
        load_arrays(io.BytesIO(b"\x80"), tmp_path)
