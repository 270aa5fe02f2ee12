"""What is attacked: a reader of files, or a handler of messages."""

import contextlib
import faulthandler
import random
import resource
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from fuzz.mutations import Mutate, spoil_bytes
from ltm_core.base.errors import LtmError

MOST_SECONDS = 5.0
"""Of CPU time a case."""
MOST_BYTES = 500 << 20
"""By which the process may grow in a case."""
SPARE = 2 << 30
"""Bytes that a case may ask for: faults end here, not the machine."""
HANGS_AFTER = 120.0
"""Seconds on the wall, after which the run is ended with a traceback: `MOST_SECONDS` at a twentieth of a core."""


@dataclass(frozen=True)
class Target:
    """`file`: name of the spoiled file in the folder. `seeds`: whole files, made when asked, small. `read`: takes the
    folder; whatever it raises but LtmError is a fault."""

    name: str
    file: str
    seeds: Callable[[Path], list[bytes]]
    read: Callable[[Path], object]
    mutate: Mutate = spoil_bytes

    def case(self, number: int, seeds: list[bytes]) -> bytes:
        """The spoiled bytes of a case: the same for the same number and seeds."""
        rng = random.Random(f"{self.name} {number}")
        return self.mutate(rng, rng.choice(seeds), seeds)

    def write(self, folder: Path, data: bytes) -> None:
        file = folder / self.file
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)

    def attack(self, folder: Path, data: bytes) -> None:
        """Read the bytes, which may be refused. Raises whatever is a fault."""
        self.write(folder, data)
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here
        before, begun = _status("VmRSS"), time.process_time()
        refused: LtmError | None = None
        with _bounded():
            try:
                self.read(folder)
            except LtmError as error:
                refused = error
        seconds, grown = time.process_time() - begun, _status("VmHWM") - before
        assert refused is None or str(refused)
        assert seconds <= MOST_SECONDS
        assert grown <= MOST_BYTES


@contextlib.contextmanager
def _bounded() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (_status("VmSize") + SPARE, hard))
    faulthandler.dump_traceback_later(HANGS_AFTER, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _status(key: str) -> int:
    """Bytes of a line of this process's status."""
    text = Path("/proc/self/status").read_text()
    return int(text.split(f"{key}:")[1].split()[0]) << 10
