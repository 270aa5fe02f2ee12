"""The state that the fuel map keeps of each cell, and the sizes that it depends on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from ltm_core.fuel.label_cover import cover_fields
from ltm_core.fuel.life_form import FORMS
from ltm_core.raster.tile_store_schema import Field

CAMERAS_KEPT: Final = 8
"""Cameras that a cell remembers; of more, those with the least hashes of their names."""
VIEWS: Final = 6
"""Directions from which a cell is seen. Frames of one direction are one view, whatever cameras took them: they see the
same side of the same plants, and the network errs alike on them."""
EPOCHS: Final = 2
"""Of each view, the newest ones in which it saw the cell: newer looks of a view stand in place of its older ones."""
EPOCH_S: Final = 10 * 86400
"""Length of an epoch: long enough for several weathers."""
UNIT: Final = 256
"""Evidence is kept in whole numbers of 1 / UNIT, whose sums do not depend on their order."""
TILE: Final = 32
"""Cells a side of the tiles in which the state is kept."""
EVIDENCE_VERSION: Final = 3
EXTENDED_VERSION: Final = 2
"""Knew no shares of woody pixels; a store of it is opened with none."""

EVIDENCE_FIELDS: Final[Mapping[str, Field]] = {
    "shown": Field(np.uint32, (VIEWS, EPOCHS, FORMS)),  # sum of what the frames say for each form
    "best": Field(np.uint16, (VIEWS, EPOCHS)),  # the most that a frame says
    "span": Field(np.uint32, (VIEWS, EPOCHS, 2)),  # seconds of the earliest and the latest frame; 0 none
    "epochs": Field(np.uint16, (VIEWS, EPOCHS)),  # their numbers from 1970 on, newest first; 0 none
    "first": Field(np.uint32, (FORMS,)),  # second of the earliest frame that shows the form; 0 none
    "last": Field(np.uint32, (FORMS,)),  # of the latest
    "camera_hashes": Field(np.uint32, (FORMS, 2)),  # hashes of two cameras that show the form; 0 none
    "seen_by": Field(np.uint32, (CAMERAS_KEPT,)),  # hashes of cameras that see the cell, rising; 0 none
    "last_seen": Field(np.uint32),  # second of the latest frame
    "burned_at": Field(np.uint32),  # second of the latest burn that the map was told of; 0 none
    **cover_fields(VIEWS),  # shares of woody pixels by view, of its newest epoch
}
"""The state of a cell. Seconds count from 1970; an array of each field, (tile, tile, *shape), is a tile."""
ACCUMULATED: Final = tuple(name for name in EVIDENCE_FIELDS if name not in cover_fields(VIEWS))
"""Those that `evidence_kernel.accumulate` adds to, in its order."""
