"""Compute fires with Pyretechnics, which runs in its own environment."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

import numpy as np

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.fire.effect import FireRun, FireScenario
from ltm_core.fuel.export.landscape import Landscape

VARIABLE: Final = "LTM_PYRETECHNICS"
_WORKER: Final = Path(__file__).with_name("pyretechnics_worker.py")


class FireModelError(LtmError):
    """The fire model could not be started, or failed."""


def interpreter() -> Path:
    """Return the Python interpreter with Pyretechnics: LTM_PYRETECHNICS, else that of `make fire`. Raises
    ConfigError."""
    named = os.environ.get(VARIABLE)
    found = Path(named) if named else Path(sys.prefix) / "pyretechnics/bin/python"
    if found.is_file():
        return found
    raise ConfigError(
        f"{found}: no Python with the fire model Pyretechnics; build its environment with `make fire` (its "
        f"pinned versions conflict with ours), or name one in {VARIABLE}"
    )


def spread(landscape: Landscape, scenario: FireScenario) -> tuple[FireRun, str]:
    """Compute the fire on a landscape on one core; the time grows with the fire. Return it, and the model's version.
    Raises ConfigError without an interpreter, FireModelError if the model fails."""
    wind, moisture = scenario.wind, scenario.moisture
    with tempfile.TemporaryDirectory(prefix="ltm-fire-") as folder:
        given, result = (Path(folder) / name for name in ("given.npz", "result.npz"))
        np.savez(given, bands=landscape.bands[1:])
        asked = {
            "given": str(given),
            "result": str(result),
            "row": scenario.row,
            "col": scenario.col,
            "cell": landscape.geometry.resolution,
            "minutes": 60 * scenario.hours,
            "wind_speed": wind.speed,
            "wind_from": wind.direction,
            "moisture": list(vars(moisture).values()),
        }
        command = [str(interpreter()), "-I", str(_WORKER), json.dumps(asked)]
        ended = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        if ended.returncode or not result.exists():
            words = ended.stderr.strip().splitlines() or [f"status {ended.returncode}"]
            raise FireModelError(f"Pyretechnics exited: {words[-1]}")
        with np.load(result) as found:
            return FireRun(found["arrival"] / np.float32(60), found["flame"]), ended.stdout.strip()
