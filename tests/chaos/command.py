"""The command line: `python -m chaos --minutes 30 --seed 7`, or with `--soak`."""

from __future__ import annotations

import argparse
import fcntl
import json
import random
import secrets
import signal
import sys
import tempfile
from pathlib import Path
from typing import IO

from chaos.disks import enter_own_mounts
from ltm_ros.runtime.ros_environment import apply_to_process

DOMAIN = 99
"""Below those of the tests."""


def claim(domain: int) -> IO[str]:
    """A lock on a ROS domain, held as long as the file is open: two runs on one would hear each other's frames.

    Raises BlockingIOError where another run has it.
    """
    lock = (Path(tempfile.gettempdir()) / f"ltm-chaos-domain-{domain}.lock").open("w")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.close()
        raise
    return lock


def main() -> None:
    parser = argparse.ArgumentParser(prog="chaos", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--soak", action="store_true", help="no faults: does memory grow?")
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**6), help="of the faults; drawn if not given")
    parser.add_argument("--period", type=float, default=1.0, help="seconds between two frames of a camera")
    parser.add_argument("--processes", choices=("site", "node"), default="site", help="as in a site file")
    parser.add_argument("--only", action="append", default=[], help="only this kind of fault; may be given often")
    parser.add_argument("--without", action="append", default=[], help="not this kind of fault; may be given often")
    parser.add_argument("--slack", type=float, default=1.0, help="by which times may be longer, on a busy machine")
    parser.add_argument("--domain", type=int, default=DOMAIN, help="ROS domain of the graph")
    parser.add_argument("--folder", type=Path, help="for site, state and logs, new; default: a temporary one")
    parser.add_argument("--json", type=Path, help="also write what was found into this file")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # the site ends with its run
    try:
        lock = claim(options.domain)
    except BlockingIOError:
        parser.error(f"another run is on domain {options.domain}: give another one with --domain")
    with lock:
        _run(parser, options)


def _run(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    own_disks = not options.soak and enter_own_mounts()
    apply_to_process(options.domain)
    from chaos.faults import FAULTS
    from chaos.play import play_chaos, play_soak

    kinds = [kind for kind in options.only or FAULTS if kind not in options.without]
    if unknown := {*options.only, *options.without} - FAULTS.keys():
        parser.error(f"no such fault: {', '.join(sorted(unknown))}; there are {', '.join(FAULTS)}")
    with tempfile.TemporaryDirectory(prefix="ltm-chaos-", ignore_cleanup_errors=True) as temporary:
        folder = options.folder.resolve() if options.folder else Path(temporary)
        if options.soak:
            found = play_soak(folder, options.domain, options.period, options.processes, options.minutes)
        else:
            if not own_disks:
                kinds = [kind for kind in kinds if kind != "fill-disk"]
                print("no disks are filled: this user may not mount one")
            print(f"seed {options.seed}: {', '.join(kinds)}")
            rng = random.Random(options.seed)
            found = play_chaos(
                folder,
                options.domain,
                options.period,
                options.processes,
                options.minutes,
                kinds,
                rng,
                own_disks,
                options.slack,
            )
    if options.json:
        content = {"options": {name: str(value) for name, value in vars(options).items()}, **found.content}
        options.json.write_text(json.dumps(content | {"missed": found.missed}, indent=1), encoding="utf-8")
    print("MISSED:" if found.missed else "HOLDS", *found.missed, sep="\n  ", flush=True)
    sys.exit(1 if found.missed else 0)
