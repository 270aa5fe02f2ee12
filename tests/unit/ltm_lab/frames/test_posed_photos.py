import numpy as np
import pytest

from ltm_core.base.resources import project_path
from ltm_core.site.site_io import load_site
from ltm_lab.frames.posed_photos import photos_with_views
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of


@pytest.mark.parametrize("name", ["demo", "phone"])
def test_photos_of_a_recording_have_its_poses(name: str) -> None:
    site_file, bag = project_path(f"bags/{name}/site.yaml"), project_path(f"bags/{name}/recording")
    site = load_site(site_file)
    reader = BagReader(bag)

    def recorded(topic: str) -> dict[str, object]:
        topics = {f"/{site.name}/{camera}/{topic}": camera for camera in site.cameras}
        decoded = ((topics[m.topic], reader.decode(m)) for m in reader.messages(list(topics)))
        return {f"{camera}_{stamp_of(message)}": message for camera, message in decoded}

    poses, cameras = recorded("pose"), recorded("camera_info")
    photos = list(photos_with_views(bag, site, site_file, site.open_dem(), 3))
    assert len(photos) == 3
    for stem, view, pixels in photos:
        camera = msg_to_camera(cameras[stem])
        assert (view.camera.fx, view.camera.distortion) == (camera.fx, camera.distortion)
        assert pixels.shape == (view.camera.height, view.camera.width, 3)
        np.testing.assert_allclose(view.pose.position, msg_to_pose(poses[stem]).position, atol=1e-6)
        np.testing.assert_allclose(view.pose.rotation, msg_to_pose(poses[stem]).rotation, atol=1e-9)
