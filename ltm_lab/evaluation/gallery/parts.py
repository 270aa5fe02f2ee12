"""The parts of the gallery."""

from enum import StrEnum


class Part(StrEnum):
    """The parts of the gallery; each shows one folder of the data."""

    ENGABREEN = "engabreen"
    CANYON = "canyon"
    TOWERS = "towers"
    MOUNTAINS = "mountains"

    @property
    def folder(self) -> str:
        """The folder's name."""
        return {"canyon": "grandcanyon_rm22", "towers": "hpwren_towers", "mountains": "mountain_photos"}.get(self, self)
