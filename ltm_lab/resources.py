"""Find the configuration files of the laboratory: scenarios, trainings and lists of real photos."""

from pathlib import Path


def lab_config(name: str) -> Path:
    """Return the path of `ltm_lab/config/<name>`."""
    return Path(__file__).parent / "config" / name
