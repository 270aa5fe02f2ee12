"""Show that two checkouts of this project give the same results: `python tools/same_results.py BEFORE AFTER`.

Run the jobs below in both checkouts, from the files that the project ships, and compare everything that they write.
Results of BEFORE are kept in the work folder and reused, so that AFTER can be checked again in half the time: name
another work folder if BEFORE has changed. Print a line for each job. Exit with 1 if any job differs or fails.
"""

import argparse
import hashlib
import importlib
import importlib.util
import json
import os
import re
import resource
import shlex
import shutil
import sqlite3
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import rasterio
import yaml
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message

FOLDER = Path(__file__).parent / "same_results_jobs"
FORMER = (
    (r"pose (photo \S+/photos) --guess", r"pose --\1 --poses"),
    (r"pose (photo \S+) (.*)--guess", r"pose --\1 \2--pose-guess"),
    (r"pose points (\S+) (.*)--guess", r"pose --gcps \1 \2--pose-guess"),
    (r"locate (.*)--mark (\w+)=", r"locate \1--camera \2 --pixel "),
    (r"ltm import ", r"ltm import --images "),
    (r"--focal-35mm 25", r"--focal-35mm 26"),  # then of the image's width, now of its diagonal
    (r"pose mount (\S+) (\S+) --points", r"pose --site \1 --camera \2 --gcps"),
)
"""Spelling of commands in checkouts in which `ltm pose` is one command."""
VOLATILE: tuple[tuple[str, bytes, bytes], ...] = (
    ("*.printed.txt", rb"\b\d+:\d\d:\d\d\b", b"DURATION"),  # of progress bars
    ("*.printed.txt", rb"[\d,.]+ MB free", b"MB FREE"),
    ("*.json", rb'"cpu_seconds": [\d.e-]+', b"CPU SECONDS"),
    ("run.json", rb"\b[0-9a-f]{32}\b", b"KEY"),  # digests of the program and of what depends on it
    ("manifest.parquet", rb"'file': '[^']*/", b"'file': '"),  # folder of the recording
    ("*.las", rb"(?s)\A(.{90}).{4}", rb"\1DATE"),  # day on which the file was made
)
"""What may differ between two runs: a pattern of file paths, what to look for in the file, what to replace it by."""
KEYED = re.compile(r"\b[0-9a-f]{32}\b")
"""Part of a file's name that depends on the program; such files are compared in the order of their content."""
IGNORED = ("*.lock", "*-wal", "*-shm", "scans/*.parquet")
"""Patterns of files that hold no result."""
PRINTED = ".printed.txt"
"""Suffix of what a command prints. Its numbers must be the same; its words may change."""
LISTED = 8
"""Number of differing files that are listed for each job."""

Entry = tuple[str, object]
"""A place in a file, and what stands there."""
Message = tuple[int, int, str, str]


@dataclass(frozen=True)
class Job:
    """Commands that run one after the other; jobs.yaml says what the fields mean."""

    name: str
    commands: list[str]
    uses: str = ""
    needs: str = ""


def jobs() -> list[Job]:
    """Return the jobs of jobs.yaml."""
    return [Job(**job) for job in yaml.safe_load((FOLDER / "jobs.yaml").read_text(encoding="utf-8"))]


def inputs() -> dict[str, str]:
    """Return the text of each file that the jobs read besides those of a checkout."""
    root = FOLDER / "inputs"
    return {str(path.relative_to(root)): path.read_text(encoding="utf-8") for path in sorted(root.rglob("*.*"))}


def run_job(job: Job, side: Path, checkout: Path, python: str) -> tuple[float, str]:
    """Run a job's commands anew; return the processor time in seconds, and why it failed or an empty text."""
    shutil.rmtree(side / job.name, ignore_errors=True)
    (side / job.name).mkdir()
    environment = os.environ | {"PYTHONPATH": str(checkout), "COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}
    started = _children_time()
    for number, command in enumerate(job.commands):
        if (checkout / "ltm_ros/cli/pose.py").exists():
            for now, then in FORMER:
                command = re.sub(now, then, command)  # as this checkout spells it
        words = shlex.split(command)
        program = ["-P", "-m", "ltm_ros.cli.main"] if words[0] == "ltm" else ["-P", words[0]]
        run = [python, *program, *words[1:]]
        done = subprocess.run(run, cwd=side, env=environment, capture_output=True, text=True)
        printed = f"{command}\nexit status {done.returncode}\n{done.stdout}"
        (side / job.name / f"{number}{PRINTED}").write_text(printed, encoding="utf-8")
        if done.returncode:
            last = (done.stderr or done.stdout).strip().splitlines()[-1:]
            return _children_time() - started, f"`{command}` failed: {' '.join(last)}"
    return _children_time() - started, ""


def _children_time() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def kept_or_run(job: Job, side: Path, checkout: Path, python: str) -> tuple[float, str]:
    """Return what `run_job` returns, from the last run if checkout, commands and inputs are those of that run."""
    record = side / f"{job.name}.json"
    read = {name: text for name, text in inputs().items() if f"inputs/{name}" in " ".join(job.commands)}
    key = [str(checkout), job.commands, read]
    if record.is_file() and (side / job.name).is_dir():
        kept = json.loads(record.read_text())
        if kept["key"] == key:
            return kept["seconds"], ""
    record.unlink(missing_ok=True)
    seconds, failure = run_job(job, side, checkout, python)
    if not failure:
        record.write_text(json.dumps({"key": key, "seconds": seconds}))
    return seconds, failure


def prepare(side: Path, checkout: Path, data: Path) -> None:
    """Make the folder in which the commands of one checkout run."""
    if not (checkout / "ltm_ros").is_dir():
        raise SystemExit(f"{checkout}: not a checkout of this project (it has no ltm_ros); give its root folder")
    side.mkdir(parents=True, exist_ok=True)
    for name, target in (("checkout", checkout), ("data", data)):
        (side / name).unlink(missing_ok=True)
        (side / name).symlink_to(target)
    for name, text in inputs().items():
        (side / "inputs" / name).parent.mkdir(parents=True, exist_ok=True)
        (side / "inputs" / name).write_text(text, encoding="utf-8")


def differences(before: Path, after: Path) -> Iterator[str]:
    """Yield a text for each file of two folders that differs, with the first place that does."""
    first, second = _files(before), _files(after)
    for name in sorted(first.keys() | second.keys()):
        if name not in second or name not in first:
            yield f"{name}: only in {'BEFORE' if name in first else 'AFTER'}"
        elif difference := file_difference(name, first[name], second[name]):
            yield f"{name}: {difference}"


def _files(folder: Path) -> dict[str, Path]:
    files = [path for path in folder.rglob("*") if path.is_file() and not any(map(path.match, IGNORED))]
    keyed = sorted(
        (path for path in files if KEYED.search(path.name)), key=lambda path: (path.parent, path.read_bytes())
    )
    names = {path: KEYED.sub(f"KEY{number}", path.name) for number, path in enumerate(keyed)}
    return {str(path.relative_to(folder).with_name(names.get(path, path.name))): path for path in files}


def file_difference(name: str, before: Path, after: Path) -> str:
    """Return where two files of the same name differ; empty if they do not."""
    if name.endswith(".mcap"):
        return message_difference(before, after)
    if name.endswith((".ltm", ".sqlite")):
        return first_difference(_rows(before), _rows(after))
    if name.endswith(".kmz"):
        return first_difference(_members(before), _members(after))
    if name.endswith(".parquet"):
        return first_difference(_table(before), _table(after))
    first, second = steady(name, before.read_bytes()), steady(name, after.read_bytes())
    if first == second:
        return ""
    if name.endswith(PRINTED):
        return first_difference(_numbers(first), _numbers(second))
    if name.endswith((".tif", ".png")):
        return raster_difference(before, after)
    return first_difference(_lines(first), _lines(second))


def steady(name: str, content: bytes) -> bytes:
    """Return a file's content without what differs between two runs."""
    for pattern, volatile, instead in VOLATILE:
        if Path(name).match(pattern):
            content = re.sub(volatile, instead, content)
    return content


def first_difference(before: list[Entry], after: list[Entry]) -> str:
    """Return the first of two lists' entries that differ, and how many do; empty if none does."""
    pairs = zip_longest(before, after, fillvalue=("end", "nothing"))
    different = [(first, second) for first, second in pairs if first[1] != second[1]]
    if not different:
        return ""
    (place, value), (_, other) = different[0]
    further = f" ({len(different):,} differ)" if len(different) > 1 else ""
    return f"{place}: {_short(value)} -> {_short(other)}{further}"


def _short(value: object) -> str:
    text = value if isinstance(value, str) else repr(value)
    return text if len(text) <= 70 else f"{text[:60]}... ({len(text):,} characters)"


def _lines(content: bytes) -> list[Entry]:
    """Return a text's lines, or a binary file's bytes in pieces."""
    if b"\0" in content:
        return [(f"bytes {start} to {start + 15}", content[start : start + 16]) for start in range(0, len(content), 16)]
    return [(f"line {number}", line.decode(errors="replace")) for number, line in enumerate(content.split(b"\n"), 1)]


def _numbers(printed: bytes) -> list[Entry]:
    """Return the numbers that a command has printed, each with its line."""
    lines = printed.decode().splitlines()
    return [
        (f"`{line.strip()}`", number) for line in lines for number in re.findall(r"[-+]?\d+(?:,\d{3})*(?:\.\d+)?", line)
    ]


def _rows(database: Path) -> list[Entry]:
    """Return all rows of an SQLite file, sorted within each table."""
    entries: list[Entry] = []
    connection = sqlite3.connect(f"file:{database}?mode=ro", uri=True)
    tables = connection.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table' ORDER BY name").fetchall()
    for name, definition in tables:
        rows = sorted(repr(row) for row in connection.execute(f'SELECT * FROM "{name}"'))
        entries += [(f"table {name}", definition)]
        entries += [(f"table {name}, row {number}", row) for number, row in enumerate(rows)]
    connection.close()
    return entries


def _members(archive: Path) -> list[Entry]:
    with zipfile.ZipFile(archive) as members:
        return [(name, members.read(name)) for name in sorted(members.namelist())]


def _table(file: Path) -> list[Entry]:
    table = pyarrow.parquet.read_table(file)
    rows = [("metadata", repr(table.schema)), *((f"row {n}", repr(row)) for n, row in enumerate(table.to_pylist()))]
    return [(place, steady(file.name, value.encode()).decode()) for place, value in rows]


def raster_difference(before: Path, after: Path) -> str:
    """Return how many cells of two rasters or pictures differ, and the first; else that the rest of the file does."""
    with rasterio.open(before) as first, rasterio.open(after) as second:
        old, new = first.read(), second.read()
        tags = first_difference(sorted(first.tags().items()), sorted(second.tags().items()))
    if old.shape != new.shape or old.dtype != new.dtype:
        return f"{old.dtype} {old.shape} -> {new.dtype} {new.shape}"
    different = np.argwhere((old != new) & ~((old != old) & (new != new)))
    if not len(different):
        return f"all cells are the same, {f'tag {tags}' if tags else 'the rest of the file differs'}"
    band, row, column = (int(index) for index in different[0])
    values = f"{old[band, row, column]} -> {new[band, row, column]}"
    return f"band {band + 1}, row {row}, column {column}: {values} ({len(different):,} cells differ)"


def message_difference(before: Path, after: Path) -> str:
    """Return the first message of two recordings that differs, with its topic and field."""
    first, second = _messages(before), _messages(after)
    if missing := sorted(first.keys() ^ second.keys()):
        return f"topic {missing[0]}: only in {'BEFORE' if missing[0] in first else 'AFTER'}"
    for topic, messages in first.items():
        for number, (old, new) in enumerate(zip_longest(messages, second[topic])):
            if old == new:
                continue
            counts = f" ({len(messages)} -> {len(second[topic])} messages)"
            if old is None or new is None or old[:3] != new[:3]:
                return f"topic {topic}, message {number}: {old and old[:3]} -> {new and new[:3]}{counts}"
            fields = first_difference(_fields_of(before, topic, old), _fields_of(after, topic, new))
            return f"topic {topic}, message {number} at {old[0]} ns: {fields}"
    return ""


def _messages(path: Path) -> dict[str, list[Message]]:
    """Return the messages of each topic in order of time: times of logging and publishing, type, digest.

    The digest is that of the fields: between fields, a serialised message has padding of any value.
    """
    topics: dict[str, list[Message]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            kind = schema.name if schema else ""
            digest = hashlib.sha256(repr([*_fields(_decoded(kind, message.data))]).encode()).hexdigest()
            topics.setdefault(channel.topic, []).append((message.log_time, message.publish_time, kind, digest))
    return {topic: sorted(messages) for topic, messages in sorted(topics.items())}


def _fields_of(path: Path, topic: str, wanted: Message) -> list[Entry]:
    """Return the fields of the message of a topic that has these times and this digest."""
    with path.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages([topic]):
            fields = [*_fields(_decoded(wanted[2], message.data))]
            if hashlib.sha256(repr(fields).encode()).hexdigest() == wanted[3]:
                return fields
    return []


def _decoded(kind: str, data: bytes) -> Any:
    package, _, name = kind.split("/")
    if importlib.util.find_spec(package) is None:  # tf2_msgs has no wheel
        return data
    return deserialize_message(data, getattr(importlib.import_module(f"{package}.msg"), name))


def _fields(value: Any, place: str = "") -> Iterator[Entry]:
    """Yield the fields of a message with their paths; an array of numbers is one field."""
    if hasattr(value, "get_fields_and_field_types"):
        for name in value.get_fields_and_field_types():
            yield from _fields(getattr(value, name), f"{place}.{name}".lstrip("."))
    elif isinstance(value, list | tuple):
        yield f"length of {place}", len(value)
        for number, item in enumerate(value):
            yield from _fields(item, f"{place}[{number}]")
    else:
        yield place, value.tobytes() if hasattr(value, "tobytes") else value


def main() -> int:
    """Run the command line; return the exit status."""
    warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)  # pictures have no place
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, help="checkout whose results are right")
    parser.add_argument("after", type=Path, help="checkout whose results are compared with them")
    parser.add_argument("--only", action="append", choices=[job.name for job in jobs()], help="job to run; repeatable")
    parser.add_argument("--work", type=Path, default=Path("out/same"), help="folder for results [default: out/same]")
    parser.add_argument("--python", default=sys.executable, help="interpreter for both checkouts [default: this one]")
    parser.add_argument("--data", type=Path, help="shared test data [default: ../shared/data of AFTER]")
    given = parser.parse_args()
    checkouts = {"before": given.before.resolve(), "after": given.after.resolve()}
    sides = {name: given.work.resolve() / name for name in checkouts}
    for name, checkout in checkouts.items():
        prepare(sides[name], checkout, (given.data or checkouts["after"].parent / "shared/data").resolve())
    used = {job.uses for job in jobs() if given.only and job.name in given.only}
    status = 0
    for job in jobs():
        if given.only and job.name not in {*given.only, *used}:
            continue
        if job.needs and not (sides["before"] / job.needs).exists():
            print(f"{job.name:12} skipped: {job.needs} is missing", flush=True)
            continue
        old = kept_or_run(job, sides["before"], checkouts["before"], given.python)
        new = run_job(job, sides["after"], checkouts["after"], given.python)
        found = [f"in {name}, {why}" for name, (_, why) in (("BEFORE", old), ("AFTER", new)) if why]
        found += differences(sides["before"] / job.name, sides["after"] / job.name)
        seconds = f"{old[0]:.0f} s of processor time before, {new[0]:.0f} s after"
        print(f"{job.name:12} {f'DIFFERENT: {found[0]}' if found else 'same'} ({seconds})", flush=True)
        for difference in found[1:LISTED]:
            print(f"{'':12} {difference}")
        if len(found) > LISTED:
            print(f"{'':12} and {len(found) - LISTED} further files")
        status |= bool(found)
    return status


if __name__ == "__main__":
    sys.exit(main())
