"""What pyproject.toml cannot say: this folder is itself the package `ltm_lab`."""

from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).parent

setup(
    packages=["ltm_lab", *(f"ltm_lab.{name}" for name in find_packages(str(HERE)))],
    package_dir={"ltm_lab": "."},
    package_data={"ltm_lab": ["config/**/*"], "ltm_lab.evaluation": ["templates/*"]},
)
