from pathlib import Path

import numpy as np
import pytest
from scenes.tiny_training import TINY, with_steps

from ltm_core.base.errors import ConfigError
from ltm_core.vision.labels import LabelSet
from ltm_lab.training.config import NetworkConfig
from ltm_lab.training.training_frames import read_split


@pytest.mark.parametrize("scene", [False, True])
def test_a_training_goes_on_from_an_exported_network(scene: bool, frames: Path, tmp_path: Path) -> None:
    """At its first step it gives the exported network's own labels; a checkpoint of it can be resumed."""
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_core.vision.manifest import NetworkManifest
    from ltm_lab.training.export import export, load_exported
    from ltm_lab.training.loop import Run, score, train

    tiny = TINY.model_copy(update={"network": TINY.network.model_copy(update={"scene": scene})})
    split, labels = read_split(frames, tiny.split, 7), LabelSet.load()
    first, _ = train(with_steps(tiny, 8), split, 7, lambda _: None)
    base = NetworkManifest.load(export(first, tiny, labels, tmp_path / "base"))
    weights = load_exported(base, fixed=1).state_dict()
    config = with_steps(tiny, 4)
    run = Run.start(config, 7, weights)
    before, after = (score(network, split.test, tiny, 7) for network in (first, run.network))
    assert np.abs(before.confusion - after.confusion).sum() < 0.01 * before.confusion.sum()
    network, run = train(config, split, 7, lambda _: None, run, tmp_path / "checkpoint.pt")
    assert run.losses[0] > 0
    resumed = Run.resume(tmp_path / "checkpoint.pt", config, 7)
    same = (torch.equal(a, b) for a, b in zip(resumed.network.parameters(), run.network.parameters(), strict=True))
    assert all(same)
    second = load_exported(NetworkManifest.load(export(network, tiny, labels, tmp_path / "next")))
    assert not torch.equal(second.classes.bias, weights["classes.bias"])
    wider = config.model_copy(update={"network": NetworkConfig(width=32, pretrained=False)})
    with pytest.raises(ConfigError, match=r"another network than configured.*width 32"):
        Run.start(wider, 7, weights)
