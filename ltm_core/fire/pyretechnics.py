"""Compute fires with Pyretechnics, which runs in its own environment."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.fire.effect import FireRun, FireScenario, Moisture, Wind
from ltm_core.fuel.export.landscape import Landscape

VARIABLE: Final = "LTM_PYRETECHNICS"
_WORKER: Final = Path(__file__).with_name("pyretechnics_worker.py")
_LAST_WORDS: Final = 2000


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


class Pyretechnics:
    """Context manager of one process of the model, which computes one fire after the other. Raises FireModelError if it
    cannot be started or ends early."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="ltm-fire-")
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed in `close`
        self._process = subprocess.Popen(
            [str(interpreter()), "-I", str(_WORKER)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            text=True,
        )
        try:
            self.version = str(self._answer()["version"])
        except FireModelError:
            self.close()
            raise

    def spread(self, landscape: Landscape, scenario: FireScenario) -> FireRun:
        """Compute the fire on a landscape on one core; the time grows with the fire."""
        given, result = (Path(self._folder.name) / name for name in ("given.npz", "result.npz"))
        np.savez(given, bands=landscape.bands[1:])
        self._ask(
            {
                "given": str(given),
                "result": str(result),
                "row": scenario.row,
                "col": scenario.col,
                "cell": landscape.geometry.resolution,
                "minutes": 60 * scenario.hours,
                **_weather(scenario.wind, scenario.moisture),
            }
        )
        with np.load(result) as found:
            return FireRun(found["arrival"] / np.float32(60), found["flame"])

    def head_rates(self, codes: Sequence[int], wind: Wind, moisture: Moisture) -> dict[int, tuple[float, float]]:
        """Return rate of spread in m/min and flame length in metres of a head fire on flat open ground, by fuel
        code."""
        answer = self._ask({"rates": {"codes": list(codes), **_weather(wind, moisture)}})
        return {int(code): (float(rate), float(flame)) for code, (rate, flame) in answer.items()}

    def close(self) -> None:
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):  # closing writes what is left: the process may be gone
                self._process.stdin.close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._said.close()
        self._folder.cleanup()

    def _ask(self, question: Mapping[str, Any]) -> dict[str, Any]:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(question) + "\n")
            self._process.stdin.flush()
        except OSError as error:
            raise FireModelError(f"Pyretechnics exited: {self._last_words()}") from error
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            self._process.wait()
            raise FireModelError(f"Pyretechnics exited: {self._last_words()}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _last_words(self) -> str:
        self._said.seek(0)
        words = self._said.read()[-_LAST_WORDS:].decode("utf-8", "replace").strip().splitlines()
        return words[-1] if words else f"status {self._process.returncode}"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _weather(wind: Wind, moisture: Moisture) -> dict[str, Any]:
    m = moisture
    shares = [m.dead_1h, m.dead_10h, m.dead_100h, m.live_herbaceous, m.live_woody, m.foliar]
    return {"wind_speed": wind.speed, "wind_from": wind.direction, "moisture": shares}
