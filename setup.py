"""What pyproject.toml cannot say: the files that ROS looks for beside the Python packages.

pip and colcon alike install them: config and launch files in share/ltm, the package's mark in the ament
index, and in lib/ltm one script a node for `ros2 run ltm <node>`.
"""

from pathlib import Path

from setuptools import Distribution, setup

ROOT = Path(__file__).parent


def tree(source: str, target: str) -> list[tuple[str, list[str]]]:
    """All files below `source`, as data files of the same layout below `target`."""
    by_folder: dict[str, list[str]] = {}
    for path in sorted((ROOT / source).rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            folder = path.parent.relative_to(ROOT / source)
            by_folder.setdefault(str(Path(target) / folder), []).append(str(path.relative_to(ROOT)))
    return sorted(by_folder.items())


class PlainDistribution(Distribution):
    """Keeps `requires-python` as text: colcon reads a package's metadata back from its repr, which an object breaks."""

    def parse_config_files(self, *arguments: object, **options: object) -> None:
        super().parse_config_files(*arguments, **options)
        for holder in (self, self.metadata):
            if getattr(holder, "python_requires", None) is not None:
                holder.python_requires = str(holder.python_requires)


setup(
    distclass=PlainDistribution,
    license="Apache-2.0",
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/ltm"]),
        # `colcon build --symlink-install` builds in a folder to which it links only what is named here.
        ("share/ltm", ["package.xml", "pyproject.toml", "README.md"]),
        *tree("config", "share/ltm/config"),
        *tree("ltm_ros/launch", "share/ltm/launch"),
        (
            "lib/ltm",
            sorted(str(path.relative_to(ROOT)) for path in (ROOT / "scripts").iterdir() if path.name != "node"),
        ),
    ],
)
