"""What the nodes of a tower with two cameras say on /diagnostics, in all its kinds of keys."""

from ltm_ros.runtime.clocks import KernelClock
from ltm_ros.runtime.health import Health
from ltm_ros.tower.machine import Disk, Machine
from ltm_ros.tower.tower_status import TowerStatus, TowerWatch

NOW_S = 1_750_000_000.0
NODES = (
    "/ridge/fuel_map",
    "/ridge/uplink",
    *(f"/ridge/{camera}/{node}" for camera in ("north", "east") for node in ("capture", "topodepth")),
    *("/ridge/north/fuel_votes", "/ridge/east/fuel_votes"),
)


def healths() -> dict[str, Health]:
    """Of each node, by what nodes really count with."""
    made = {name: Health() for name in NODES}
    for number, name in enumerate(NODES, 1):
        health = made[name]
        for frame in range(7 * number):
            health.received("image" if name.count("/") > 2 else "/ridge/north/fuel/votes")
            health.worked(0.001 * frame * number)
            if frame % 2:
                stamp = (1 + frame) * 10**11
                health.published("posed/image", stamp, stamp + number * 10**9 // 4)
        health.used(1.25 * number)
    for camera, age_s, shed in (("north", 4.5, 3), ("east", 700.25, 11)):
        capture, judge = made[f"/ridge/{camera}/capture"], made[f"/ridge/{camera}/topodepth"]
        capture.gauge("newest_stamp", f"{NOW_S - age_s:.3f}")
        capture.gauge("waiting", 2)
        capture.drop("shed", "more come than can be done", shed)
        capture.drop("no_pose", "publish one", 2)
        capture.note("out_of_order")
        judge.note("verdict.ok")
        judge.note("verdict.pose_suspected")
        judge.gauge("verdict", "ok" if camera == "north" else "pose_suspected")
        judge.gauge("inlier_ratio", "0.625")
        judge.gauge("last_verdict", "pose_suspected: the skyline is 2.1 degrees off")
    made["/ridge/north/topodepth"].gauge("inlier_ratio", "nan")
    for key, value in (("outbox_frames", 412), ("outbox_bytes", 5_130_000), ("outbox_age_s", "7260.5"), ("link_up", 0)):
        made["/ridge/uplink"].gauge(key, value)
    return made


def watch_of(made: dict[str, Health]) -> TowerWatch:
    watch = TowerWatch("ridge", NODES, frame_limit_s=120.0)
    for name, health in made.items():
        watch.hear(name, health.troubled, health.last_error or "ok", health.summary(), now_s=50.0)
    return watch


def status_of(watch: TowerWatch, now_s: float = 51.0) -> TowerStatus:
    disks = [Disk("/state", 100_000_000_000, 2_000_000_000), Disk("/gone", -1, -1)]
    versions = {"ltm": "0.1.0", "ros-rclpy": "7.1.6"}
    machine = Machine(versions, KernelClock(False, None), disks, 8_000_000_000, 3_000_000_000)
    return watch.status(now_s, NOW_S, machine)
