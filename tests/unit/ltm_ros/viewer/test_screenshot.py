from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from ltm_core.base.errors import ConfigError

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

from ltm_ros.viewer.server import screenshot


@pytest.mark.slow
def test_screenshot_shows_the_recording(tmp_path: Path, recording: Path) -> None:
    if not list(Path("/usr/share/vulkan/icd.d").glob("*.json")):
        pytest.skip("needs a Vulkan driver: apt-get install mesa-vulkan-drivers libgl1-mesa-dri")
    shares = {}
    for tab in (None, "cameras", "Health"):
        path = tmp_path / f"deep/{tab}.png"
        screenshot(recording, path, (1200, 700), tab)
        picture = cv2.imread(str(path))[..., ::-1].astype(int)
        assert picture.shape[1] >= 1200
        shares[tab] = (np.abs(picture - (200, 100, 30)).max(axis=-1) < 12).mean()
    assert shares[None] > 0.01, "the camera's image is on the screen"
    assert shares["cameras"] > 2 * shares[None], "the images of both cameras, larger"
    assert shares["Health"] < 0.001
    with pytest.raises(ConfigError, match="Site, Cameras, Fuel, Health"):
        screenshot(recording, tmp_path / "none.png", tab="Depth")
