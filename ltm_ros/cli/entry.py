"""Run a command line: invalid input ends with a message and status 1, not with a traceback."""

from __future__ import annotations

import errno
import os
import sys

import typer

from ltm_core.base.errors import LtmError

_PLACE_ERRORS = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""A file or a file system that the user must see to: what was checked before may change while a command works."""


def run_command_line(cli: typer.Typer, program: str, extras: dict[str, str]) -> None:
    """Run `cli` as `program`; `extras`: what to install for each optional Python package that a command needs."""
    if not sys.stdout.isatty():
        os.environ.setdefault("COLUMNS", "120")  # a log is no 80 characters wide: tables would lose figures
    try:
        cli()
    except LtmError as error:
        print(f"{program}: {error}", file=sys.stderr)
        sys.exit(1)
    except OSError as error:
        if error.errno not in _PLACE_ERRORS:
            raise
        print(f"{program}: {error.filename or 'a file'}: {error.strerror}", file=sys.stderr)
        sys.exit(1)
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in extras:
            raise
        print(f"{program}: needs {error.name}: pip install '{extras[missing]}', or see `ltm doctor`", file=sys.stderr)
        sys.exit(1)
