"""The thread in which a camera is asked: whatever happens there is the matter of that camera alone."""

from __future__ import annotations

import random
import sys
import threading
import traceback

from ltm_core.base.errors import LtmError
from ltm_core.base.redaction import redacted
from ltm_ros.cameras.camera_source import CameraSource, camera_backoff
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.heartbeat import Activity

SPREAD_S = 2.0
"""In which the cameras of a process are first asked, one after the other."""
END_S = 2.0
"""For which a camera that is being asked is waited for at the end."""


class SourceThread:
    """Runs `source.step` until it is told to end; a bug in it is counted (`crash`), told, and tried again later."""

    def __init__(self, name: str, source: CameraSource, health: Health, activity: Activity) -> None:
        self._name, self._source, self._health, self._activity = name, source, health, activity
        self._stopping = threading.Event()
        self._crashes = camera_backoff()
        self._thread = threading.Thread(target=self._run, name=f"source {name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Let the step at work come to its end, for a moment."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join(END_S)

    def _run(self) -> None:
        pause = random.uniform(0.0, SPREAD_S)  # nosec B311 # spreads load, guards nothing
        while not self._stopping.wait(pause):
            with self._activity.turn(f"picture of {self._name}"):
                pause = self._step()
        self._source.close()

    def _step(self) -> float:
        try:
            pause = self._source.step()
        except LtmError as error:
            self._health.drop(cause_of(error), str(error))
            pause = self._crashes.failed()
        except Exception as error:
            self._tell(error)
            self._health.drop("crash", f"{type(error).__name__}: a bug; the camera is asked again; see the log")
            try:
                self._source.close()
            except (
                Exception
            ) as another:  # of a connection that the bug has left half done: it is forgotten all the same
                self._tell(another)
            pause = self._crashes.failed()
        else:
            self._crashes.succeeded()
        return pause

    @staticmethod
    def _tell(error: Exception) -> None:
        # Its message may hold what another library was given.
        print(redacted("".join(traceback.format_exception(error, chain=False))), file=sys.stderr)
