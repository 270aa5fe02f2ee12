from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes.rerun_site import STAMP, chunks

pytest.importorskip("rerun", reason="the viewer's extra is not installed")


def test_recording_holds_scene_and_pictures(recording: Path) -> None:
    rows = chunks(recording)
    assert len(rows["/map/terrain"][0]["Mesh3D:vertex_positions"]) == 70 * 110
    (tile, *_) = [row for name, found in rows.items() if name.startswith("/map/fuel/") for row in found]
    assert tile["Mesh3D:albedo_factor"][0] & 0xFF < 255, "one sees the terrain through the fuel layer"
    cells = sum(
        len(r["Mesh3D:triangle_indices"]) // 2 for n, f in rows.items() if n.startswith("/map/fuel/") for r in f
    )
    assert cells == 150
    for camera in ("north", "south"):
        (photo,) = rows[f"/map/cameras/{camera}/photo"]
        assert photo["stamp"] == STAMP
        shown = cv2.imdecode(np.array(photo["EncodedImage:blob"][0], np.uint8), cv2.IMREAD_COLOR)
        assert shown.shape == (540, 960, 3)
        assert np.abs(shown[..., ::-1].reshape(-1, 3).mean(axis=0) - (200, 100, 30)).max() < 6, "RGB, not BGR"
        (labels,) = rows[f"/map/cameras/{camera}/labels"]
        ids = np.array(labels["SegmentationImage:buffer"][0], np.uint8).reshape(540, 960)
        assert set(np.unique(ids)) == {0, 3}
        assert (ids[200:] == 3).all()
        assert len(rows[f"/map/points/{camera}"][0]["Points3D:positions"]) <= 15_000
        assert rows[f"/depth/{camera}"][0]["EncodedImage:media_type"] == ["image/jpeg"]
        difference = cv2.imdecode(
            np.array(rows[f"/fusion/{camera}/difference"][0]["EncodedImage:blob"][0], np.uint8), cv2.IMREAD_COLOR
        )
        assert difference[400].mean() > difference[200].mean() + 20, "ten metres apart is brighter than none"
        assert difference[50].mean() > 200, "the sky of both is sky"
    assert "/fusion/north/network" in rows
    assert "/fusion/south/network" not in rows
    context = rows["/"][0]["AnnotationContext:context"][0]
    names = {entry["class_id"]: entry["class_description"]["info"]["label"] for entry in context}
    assert names[3] == "tree"
    assert names[255] == "unlabelled"


def test_recording_holds_what_changed_and_forgets_what_changed_back(recording: Path) -> None:
    rows = chunks(recording)
    first, second = sorted(rows["/map/change"], key=lambda row: row["stamp"])
    assert len(first["Points3D:positions"]) == 3
    np.testing.assert_allclose(second["Points3D:positions"], [[100.5, 219.5, 480.0], [3.5, 292.5, 470.0]])
