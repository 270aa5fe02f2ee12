"""Write the files of a task: votes, and the terrain's data."""

from __future__ import annotations

import io
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ltm_core.base.errors import LtmError
from ltm_core.base.types import Columns, Float32Array
from ltm_core.fuel.vote_columns import columns_to_votes
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.frame_steps import LabellingConfig, TracingConfig
from ltm_core.pipeline.fusing_step import FrameSteps, FrameVotes, FusingConfig, MeasuredFrame
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_ros.archive.content_digest import measured_digest, votes_digest
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.pictures import ArchiveImageReader
from ltm_ros.archive.plan import MEASURED, VOTES, Task, TaskSettings, other_files
from ltm_ros.runtime.health import cause_of

ABOUT = "ltm"
"""Metadata key of a file that describes its content as JSON."""
_MEASURED = pa.schema(
    [
        ("stamp_ns", pa.int64()),
        ("shape", pa.list_(pa.int32())),
        ("depth", pa.binary()),
        ("sigma", pa.binary()),
        ("label_shape", pa.list_(pa.int32())),
        ("labels", pa.binary()),
    ]
)


@dataclass(frozen=True)
class LostFrame:
    """A frame without votes, and the reason."""

    camera: str
    stamp_ns: int
    cause: str
    why: str


def frame_files(task: Task, settings: TaskSettings, wanted: Collection[str]) -> dict[str, bytes]:
    """Return the requested files (VOTES, MEASURED), from one pass over the images.

    Votes have one row per cell that a frame sees, with `frame` as its number in the file's metadata; measured data has
    one row per frame. Raises ArchiveError if an image cannot be read any more, because that must not count as a lost
    frame."""
    camera = task.frames[0].camera
    steps = steps_of(task, settings, MEASURED in wanted)
    votes, measured = _VotesFile(), MeasuredFile()
    reader = ArchiveImageReader()
    for frame in task.frames:
        picture = reader.read(frame)
        try:
            posed = PosedImage(picture.rgb(), frame.calibration, frame.pose, frame.stamp_ns, camera)
            at_work = steps.of(posed, frame.pose_covariance)
        except LtmError as error:
            votes.lose(frame, error)
            measured.lose(frame, error)
            continue
        if VOTES in wanted:
            try:
                votes.take(frame, at_work.votes())
            except LtmError as error:
                votes.lose(frame, error)
        if MEASURED in wanted:
            try:
                measured.take(frame, at_work.measured(frame.known_covariance))
            except LtmError as error:
                measured.lose(frame, error)
    about = {"camera": camera, "model": steps.described}
    made = {VOTES: votes.content, MEASURED: measured.content}
    return {name: made[name](about) for name in wanted}


class _Lost:
    """Frames missing in a file, and the reasons."""

    def __init__(self) -> None:
        self._lost: list[LostFrame] = []

    def lose(self, frame: ArchiveFrame, error: LtmError) -> None:
        self.tell_of(frame, cause_of(error), str(error))

    def tell_of(self, frame: ArchiveFrame, cause: str, why: str) -> None:
        place = f"{frame.file}, stamp {frame.stamp_ns} ns"
        self._lost.append(LostFrame(frame.camera, frame.stamp_ns, cause, f"{why} ({place})"))

    @property
    def lost(self) -> list[dict[str, object]]:
        return [asdict(one) for one in self._lost]


class _VotesFile(_Lost):
    def __init__(self) -> None:
        super().__init__()
        self._parts: list[Columns] = []
        self._listed: list[dict[str, object]] = []

    def take(self, frame: ArchiveFrame, found: FrameVotes) -> None:
        number = np.full(len(found.columns["x"]), len(self._listed), np.uint32)
        self._parts.append({"frame": number, **found.columns})
        self._listed.append({"stamp_ns": frame.stamp_ns, "reason": found.reason})

    def content(self, about: Mapping[str, object]) -> bytes:
        return packed_table(pa.table(_stacked(self._parts)), {**about, "frames": self._listed, "lost": self.lost})


class MeasuredFile(_Lost):
    """One row group per frame, so that frames can be read one at a time; kept compressed. A frame without a network
    result counts as lost, although the terrain takes it, as live."""

    def __init__(self) -> None:
        super().__init__()
        self._file = io.BytesIO()
        self._writer = pq.ParquetWriter(self._file, _MEASURED, compression="zstd")

    def take(self, frame: ArchiveFrame, found: MeasuredFrame) -> None:
        row = {
            "stamp_ns": frame.stamp_ns,
            "shape": found.depth.shape,
            "depth": _planes(found.depth),
            "sigma": _planes(found.sigma),
            "label_shape": found.labels.shape,
            "labels": found.labels.tobytes(),
        }
        self._writer.write_table(pa.Table.from_pylist([row], _MEASURED))
        if found.trouble:
            self.tell_of(frame, "network", found.trouble)

    def content(self, about: Mapping[str, object]) -> bytes:
        self._writer.add_key_value_metadata({ABOUT: json.dumps({**about, "lost": self.lost})})
        self._writer.close()
        return self._file.getvalue()


def _planes(values: Float32Array) -> bytes:
    """Group the first bytes of all numbers, then the second ones, and so on, which compresses better."""
    return np.ascontiguousarray(values, np.float32).view(np.uint8).reshape(-1, 4).T.tobytes()


def _from_planes(content: bytes, shape: Sequence[int]) -> Float32Array:
    planes = np.frombuffer(content, np.uint8).reshape(4, -1)
    return np.ascontiguousarray(planes.T).view(np.float32).reshape(tuple(shape))


def read_measured(file: BinaryIO) -> Iterator[tuple[int, MeasuredFrame]]:
    """Yield stamp and content of each frame of a file, in its order."""
    found = pq.ParquetFile(file)
    for number in range(found.num_row_groups):
        (row,) = found.read_row_group(number).to_pylist()
        shape = tuple(row["label_shape"])
        labels = np.frombuffer(row["labels"], np.uint8).reshape(shape)
        depth, sigma = (_from_planes(row[name], row["shape"]) for name in ("depth", "sigma"))
        yield row["stamp_ns"], MeasuredFrame(depth, sigma, labels)


def lost_of_measured(file: BinaryIO) -> list[LostFrame]:
    """Return frames without measured data, and the reasons."""
    about = json.loads(pq.ParquetFile(file).metadata.metadata[ABOUT.encode()])
    return [LostFrame(**one) for one in about["lost"]]


def _stacked(parts: Sequence[Columns]) -> Columns:
    """Return all rows; a class that a frame does not see has no pixels."""
    kinds = {name: column.dtype for part in parts for name, column in part.items()}
    return {
        name: np.concatenate([part.get(name, np.zeros(len(part["frame"]), kind)) for part in parts])
        for name, kind in kinds.items()
    }


def packed_table(table: pa.Table, about: Mapping[str, object]) -> bytes:
    """Return a table as Parquet, with JSON about its content."""
    file = io.BytesIO()
    pq.write_table(table.replace_schema_metadata({ABOUT: json.dumps(about)}), file, compression="zstd")
    return file.getvalue()


def read_packed(content: bytes) -> pa.Table:
    """Read the result of `packed_table`, in this thread: for small files, more threads cost more than they save."""
    return pq.ParquetFile(io.BytesIO(content)).read(use_threads=False)


def read_votes(content: bytes, geometry: GridGeometry, labels: LabelSet) -> Iterator[CellVotes]:
    """Yield the votes of a file's frames, in its order. Raises MessageError if they are on another grid."""
    table = read_packed(content)
    about = json.loads(table.schema.metadata[ABOUT.encode()])
    columns = {name: table[name].to_numpy() for name in table.column_names}
    bounds = np.searchsorted(columns.pop("frame", np.zeros(0)), np.arange(len(about["frames"]) + 1))
    for frame, begin, end in zip(about["frames"], bounds, bounds[1:], strict=False):
        of_frame = {name: column[begin:end] for name, column in columns.items()}
        yield columns_to_votes(of_frame, geometry, labels.names, frame["stamp_ns"], about["camera"])


def steps_of(task: Task, settings: TaskSettings, measure: bool) -> FrameSteps:
    """Create the steps of a task. Raises ArchiveError if the site's files have changed during the run."""
    fusing = settings.fusing if measure else None
    camera = task.frames[0].camera
    return _steps(settings.site, camera, settings.tracing, settings.labelling, task.steps_key, fusing, task.fusing_key)


@lru_cache(maxsize=2)
def _steps(
    site: str,
    camera: str,
    tracing: TracingConfig,
    labelling: LabellingConfig,
    key: str,
    fusing: FusingConfig | None,
    fusing_key: str,
) -> FrameSteps:
    found = load_site(site)
    if votes_digest(found, camera, tracing, labelling) != key:
        raise other_files(site)
    if fusing is not None and measured_digest(found, camera, key, fusing) != fusing_key:
        raise other_files(site)
    return FrameSteps(found, camera, tracing, labelling, fusing)
