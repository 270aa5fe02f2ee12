"""Run a module as a process that its runner supervises.

Runs a module as a process that its runner watches and that does not outlive it.

`python -m ltm_ros.launching.supervised MODULE ARGUMENTS` is what `start_supervised` starts; the module runs as under
`python -m MODULE ARGUMENTS`. Standard library only, so that the watch begins before the module's own imports.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import faulthandler
import os
import runpy
import signal
import subprocess  # nosec B404 # argument lists, no shell
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from ltm_ros.launching.graph import CAMERAS_MODULE, ProcessSpec, nodes_json, parameters_yaml
from ltm_ros.runtime.heartbeat import HEARTBEAT, STARTING
from ltm_ros.runtime.process_memory import steady_allocation

DESCRIPTOR = "LTM_HEARTBEAT"
"""Environment variable that holds the number of the heartbeat's file descriptor."""
SHOW_STACKS = signal.SIGUSR1
"""Makes a process write what each of its threads is at, whatever they are at."""
GRACE_S = signal.SIGUSR2.value
"""Seconds in which a process ends whose runner is gone; 12. See `die_with_parent`."""

_PR_SET_PDEATHSIG = 1


def supervised_command(module: str, *arguments: str) -> list[str]:
    return [sys.executable, "-m", "ltm_ros.launching.supervised", module, *arguments]


def start_supervised(command: Sequence[str], environment: Mapping[str, str]) -> tuple[subprocess.Popen[str], int]:
    """Start a process with both outputs in one pipe, and the descriptor on which its heartbeats come; close that.

    The thread that calls it must live as long as the process, for Linux takes that thread for the parent. The process
    leads a session of its own: Ctrl-C in a terminal reaches the runner alone, which then stops every node in order, and
    whatever a node itself has started can be ended with it. Raises OSError.
    """
    heard, told = os.pipe()
    try:
        process = subprocess.Popen(  # nosec B603 # no shell, no argument from the wire
            list(command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={**environment, DESCRIPTOR: str(told)},
            pass_fds=(told,),
            start_new_session=True,
            text=True,
            errors="replace",
        )
    except BaseException:
        os.close(heard)
        raise
    finally:
        os.close(told)
    return process, heard


def signal_at_parents_death(number: int) -> None:
    """The process gets this signal when its parent, the thread that started it, ends. Each thread may ask for one."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)


def die_with_parent() -> None:
    """From here on this process ends within `GRACE_S` of its parent, even when it is stuck in a call that holds the
    interpreter's lock, where no Python code runs. Call it from the main thread; `_end` asks it to end in order.
    """
    libc = ctypes.CDLL(None)
    libc.signal.argtypes = (ctypes.c_int, ctypes.c_void_p)
    # A handler is called with the number of its signal, and alarm(2) takes seconds: it is a handler as it stands, needs
    # no interpreter, and SIGALRM then ends the process.
    libc.signal(GRACE_S, ctypes.cast(libc.alarm, ctypes.c_void_p))
    signal_at_parents_death(GRACE_S)


def _wake() -> None:
    """A process that is stopped (SIGSTOP) goes on, to end, when its parent has ended."""
    signal_at_parents_death(signal.SIGCONT)


def _end() -> None:
    """The runner is gone: end with all that this process has started."""
    signal.alarm(GRACE_S)
    # Nobody reads its last words, and an error about that shall not keep it from its end.
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for output in (1, 2):
        os.dup2(nowhere, output)
    os.kill(0, signal.SIGTERM)
    time.sleep(GRACE_S - 2)
    os.kill(0, signal.SIGKILL)


def _leave(status: list[int]) -> None:
    """The end of the process, where the module came to its own. For the interpreter to take every module apart first,
    as it does otherwise, takes a fifth to a third of a second of processor time, while the site waits for its stop.
    """
    if status:
        for output in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                output.flush()
        os._exit(status[0])


def main() -> None:
    steady_allocation()
    status: list[int] = []
    # Before the module registers anything: the last to run, when its threads have ended and all that it asked for is
    # done.
    atexit.register(_leave, status)
    STARTING.begin(sys.argv[1], slow=True)
    faulthandler.register(SHOW_STACKS)
    descriptor = int(os.environ.pop(DESCRIPTOR))
    os.set_inheritable(descriptor, False)
    die_with_parent()
    # When the runner has gone already, the pipe says so at once.
    HEARTBEAT.start(descriptor, prepare=_wake, reader_gone=_end)
    del sys.argv[0]
    try:
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):  # else Python prints it first
            status.append(end.code or 0)
        raise
    status.append(0)


if __name__ == "__main__":
    main()


_QUIET = ("--disable-external-lib-logs",)
"""A node's output is kept by us; ROS's own log files in ~/.ros would grow beside it."""


def process_command(spec: ProcessSpec, folder: Path) -> list[str]:
    """The command of a process under its supervisor; what its nodes are told of is written into `folder`."""
    file = folder / spec.label.replace("/", ".")
    if spec.shared:
        nodes = file.with_name(f"{file.name}.json")
        nodes.write_text(nodes_json(spec.nodes), encoding="utf-8")
        return supervised_command(CAMERAS_MODULE, str(nodes), "--ros-args", *_QUIET)
    node = spec.nodes[0]
    parameters = file.with_name(f"{file.name}.yaml")
    parameters.write_text(parameters_yaml(node.parameters), encoding="utf-8")
    remappings = [("__ns", node.namespace), ("__node", node.name), *node.remappings]
    command = supervised_command(node.module, "--ros-args")
    command += [part for old, new in remappings for part in ("-r", f"{old}:={new}")]
    return [*command, "--params-file", str(parameters), *_QUIET]
