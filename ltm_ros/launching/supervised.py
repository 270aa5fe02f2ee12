"""Run a module as a process that its runner watches and that does not outlive the runner.

`start_supervised` runs `python -m ltm_ros.launching.supervised MODULE ARGUMENTS`; the module runs as under `python -m
MODULE ARGUMENTS`. Uses only the standard library, so that supervision begins before the module's own imports."""

import atexit
import contextlib
import ctypes
import faulthandler
import os
import runpy
import signal
import subprocess  # nosec B404 # argument lists, no shell
import sys
from collections.abc import Mapping, Sequence

from ltm_ros.runtime.heartbeat import HEARTBEAT, STARTING
from ltm_ros.runtime.process_memory import steady_allocation

DESCRIPTOR = "LTM_HEARTBEAT"
"""Environment variable that holds the number of the heartbeat's file descriptor."""
SHOW_STACKS = signal.SIGUSR1
"""Signal that makes a process print the stacks of all its threads."""
_PR_SET_PDEATHSIG = 1


def supervised_command(module: str, *arguments: str) -> list[str]:
    return [sys.executable, "-m", "ltm_ros.launching.supervised", module, *arguments]


def start_supervised(command: Sequence[str], environment: Mapping[str, str]) -> tuple[subprocess.Popen[str], int]:
    """Start a process with both outputs in one pipe; return it with its heartbeat descriptor, which the caller closes.

    The calling thread must live as long as the process, because Linux regards it as the parent. The process has its own
    session, so that Ctrl-C reaches only the runner. Raises OSError."""
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


def end_with_parent() -> None:
    """Have Linux end this process with the thread that started it, even if it is stopped or holds Python's lock."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _leave(status: list[int]) -> None:
    """End the process without the interpreter's teardown, which takes 0.2 to 0.3 s of processor time."""
    if status:
        for output in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                output.flush()
        os._exit(status[0])


def main() -> None:
    steady_allocation()
    status: list[int] = []
    # Registered first, so it runs last, after the module's threads and exit handlers.
    atexit.register(_leave, status)
    STARTING.begin(sys.argv[1], slow=True)
    faulthandler.register(SHOW_STACKS)
    descriptor = int(os.environ.pop(DESCRIPTOR))
    os.set_inheritable(descriptor, False)
    end_with_parent()
    # If the runner dies, this process ends with everything that it has started; if it has died already, at once.
    HEARTBEAT.start(descriptor, reader_gone=lambda: os.kill(0, signal.SIGKILL))
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
