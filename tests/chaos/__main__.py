"""`python -m chaos [--minutes 30] [--seed N] [--soak]`; see `ltm_lab/records/2026-11-security.md`."""

import argparse
import fcntl
import random
import secrets
import signal
import sys
import tempfile
from pathlib import Path

from chaos.disks import enter_own_mounts
from ltm_ros.runtime.ros_environment import apply_to_process

DOMAIN = 99
"""Below those of the tests."""


def main() -> None:
    parser = argparse.ArgumentParser(prog="chaos", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--soak", action="store_true", help="inject no faults; measure the growth of memory")
    parser.add_argument(
        "--seed", type=int, default=secrets.randbelow(10**6), help="seed of the faults; default: random"
    )
    parser.add_argument("--slack", type=float, default=1.0, help="factor on the allowed times, for a busy machine")
    parser.add_argument("--domain", type=int, default=DOMAIN, help="ROS domain of the graph")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # the site ends with its run
    with (Path(tempfile.gettempdir()) / f"ltm-chaos-domain-{options.domain}.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:  # the two would hear each other's frames
            parser.error(f"another run is on domain {options.domain}: give another one with --domain")
        own_disks = not options.soak and enter_own_mounts()
        apply_to_process(options.domain)
        from chaos.chaos_run import faults_for, soak_for
        from chaos.stage import on_stage

        missed: list[str] = []
        with (
            tempfile.TemporaryDirectory(prefix="ltm-chaos-", ignore_cleanup_errors=True) as folder,
            on_stage(Path(folder), options.domain, own_disks, missed) as stage,
        ):
            if options.soak:
                missed += soak_for(options.minutes, stage)
            else:
                print(
                    f"seed {options.seed}"
                    + ("" if own_disks else "; no disks are filled, since this user may not mount any")
                )
                missed += faults_for(options.minutes, stage, random.Random(options.seed), options.slack)
    print("MISSED:" if missed else "HOLDS", *missed, sep="\n  ", flush=True)
    sys.exit(bool(missed))


main()
