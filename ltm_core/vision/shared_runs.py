"""Runs of one network file that several ask for: what one of them computes for the others is kept until they come.

A file may answer labels and depth from one encoder, which is most of its work. Whoever asks first for a picture has all
of it computed that others in this process ask this file for; they take their part when they bring the same picture.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

_Outputs = dict[str, npt.NDArray[Any]]
_Run = Callable[[list[str]], list[npt.NDArray[Any]]]

_PICTURES: Final = 4
"""Of which parts wait, at most: cameras whose frames are worked at once. A part that nobody took makes room."""


class SharedRuns:
    """Of one file. Threads may call it at once; each part is given out once, so whoever has it may write to it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._asked: WeakKeyDictionary[object, str] = WeakKeyDictionary()
        self._waiting: deque[tuple[npt.NDArray[Any], _Outputs]] = deque(maxlen=_PICTURES)

    def join(self, owner: object, output: str) -> None:
        """`owner` will ask for `output` as long as it lives."""
        with self._lock:
            self._asked[owner] = output

    def run(self, tensor: npt.NDArray[Any], outputs: Sequence[str], compute: _Run) -> list[npt.NDArray[Any]]:
        """These outputs of a picture's tensor, which nobody changes meanwhile; `compute` gives those of its names."""
        with self._lock:
            others = [name for name in dict.fromkeys(self._asked.values()) if name not in outputs]
            for place, (of, parts) in enumerate(self._waiting):
                if all(name in parts for name in outputs) and np.array_equal(of, tensor):
                    found = [parts.pop(name) for name in outputs]
                    if not parts:
                        del self._waiting[place]
                    return found
        made = compute([*outputs, *others])
        if others:
            rest = dict(zip(others, made[len(outputs) :], strict=True))
            with self._lock:
                self._waiting.append((tensor.copy(), rest))
        return made[: len(outputs)]
