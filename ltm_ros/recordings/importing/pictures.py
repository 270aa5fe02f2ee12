"""Find the photos of an import with their sensor data; detect the type of each file or folder by its content."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from ltm_core.base.errors import RecordingError
from ltm_core.base.number_text import stamp_of_moment
from ltm_core.base.types import Float64Array
from ltm_core.cameras.sensor_pose import held_phone
from ltm_core.storage.image_io import LARGEST_FILE
from ltm_ros.recordings.importing.assumptions import Assumptions, photo_time
from ltm_ros.recordings.importing.capture_files import CaptureFiles, is_zip
from ltm_ros.recordings.importing.photo import SUFFIXES, ImportedImage, Photo, photo_of, read_photo
from ltm_ros.recordings.importing.sensor_logger import SensorTrack, camera_frames, is_sensor_logger, read_sensor_logger

_RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf", ".pef", ".srw")
_NO_PHOTO = {
    ".icloud": "only in iCloud; download the original",
    **dict.fromkeys((".mp4", ".mov", ".m4v"), "video; make photos of its frames, such as with ffmpeg"),
    **dict.fromkeys(_RAW, "raw photo; export it as JPEG"),
}
"""Why a file with this suffix is not imported."""
_TURNED_DEG = {6: 0.0, 1: 90.0, 8: 180.0, 3: 270.0}
"""Orientation of a phone by the EXIF orientation of its back camera: its sensor's rows are along the screen's side."""


@dataclass(frozen=True)
class SkippedFile:
    """File in a folder that is not imported. `why`: the reason, without the name."""

    path: Path
    why: str


def find_pictures(paths: Iterable[Path], assumed: Assumptions) -> tuple[list[ImportedImage], list[SkippedFile]]:
    """Return the photos of files, folders with their subfolders, and zips, and the files that are not imported.
    A sensor recording without photos of its own applies to all photos beside it, by their time.

    Raises RecordingError for a missing path, two photos of a name, none at all, or an unknown file type."""
    paths = list(paths)
    found: list[ImportedImage] = []
    skipped: list[SkippedFile] = []
    tracks: list[SensorTrack] = []
    for path in paths:
        if not path.exists():
            raise RecordingError(f"no photo, folder or recording at {path}")
        parts = list(_found_in(path))
        tracks += [part for part in parts if isinstance(part, SensorTrack)]
        skipped += [part for part in parts if isinstance(part, SkippedFile)]
        found += _apart([part for part in parts if isinstance(part, ImportedImage)], path)
    if tracks:
        found = [_beside(picture, tracks, assumed) for picture in found]
    names: dict[str, Path] = {}
    for picture in found:
        if picture.name in names:
            raise RecordingError(f"two photos have the name {picture.name}: {names[picture.name]} and {picture.path}")
        names[picture.name] = picture.path
    if not found and tracks:
        raise RecordingError(f"{paths[0]}: a sensor recording without photos: record `Camera`, too, or add photos")
    if not found:
        others = f" ({skipped[0].path.name}: {skipped[0].why})" if skipped else ""
        what = f"no photos in {', '.join(map(str, paths))}{others}"
        raise RecordingError(f"{what}; supported: {', '.join(SUFFIXES)} and recordings of phones")
    return found, skipped


def _apart(found: list[ImportedImage], folder: Path) -> list[ImportedImage]:
    """Put subfolders into the names of photos that would occur twice, because phones count anew in each folder."""
    count = Counter(picture.name for picture in found)
    return [
        replace(picture, name=picture.path.relative_to(folder).as_posix())
        if count[picture.name] > 1 and picture.path.is_relative_to(folder)
        else picture
        for picture in found
    ]


def _found_in(path: Path) -> Iterator[ImportedImage | SensorTrack | SkippedFile]:
    if path.is_dir() or is_zip(path):
        files = CaptureFiles(path)
        if is_sensor_logger(files):
            yield from _sensor_logger(files)
        elif path.is_dir():
            yield from _in_folder(path)
        else:
            what = f"{path}: a zip of an unknown app (it contains {', '.join(files.names[:5]) or 'nothing'})"
            raise RecordingError(f"{what} without a Location table; unpack it and give its folder of photos")
    elif (why := _NO_PHOTO.get(path.suffix.lower())) is not None:
        raise RecordingError(f"{path}: {why}")
    else:
        yield _photo_file(path)


def _in_folder(folder: Path) -> Iterator[ImportedImage | SensorTrack | SkippedFile]:
    """Yield what a folder without a capture holds. Hidden files, such as AppleDouble's `._IMG_1.JPG`, are ignored."""
    try:
        paths = sorted(folder.iterdir())
    except OSError as error:
        yield SkippedFile(folder, f"the folder cannot be read ({error.strerror})")
        return
    for path in paths:
        suffix = path.suffix.lower()
        if (path.name.startswith(".") and suffix != ".icloud") or (path.is_dir() and path.is_symlink()):
            continue
        elif path.is_dir():
            yield from _found_in(path)
        elif suffix in SUFFIXES and path.is_file():
            yield _photo_file(path)
        elif suffix in (".tif", ".tiff"):
            yield SkippedFile(path, "TIFF, perhaps a map; give the file itself to import it")
        else:
            yield SkippedFile(path, _NO_PHOTO.get(suffix, "not a supported photo"))


def _photo_file(path: Path) -> ImportedImage:
    return ImportedImage(path.name, path, lambda: read_photo(path))


def _sensor_logger(files: CaptureFiles) -> Iterator[ImportedImage | SensorTrack]:
    track, frames = read_sensor_logger(files), camera_frames(files)
    if not frames:
        yield track
    for member, stamp_ns in frames.items():
        path = files.path / Path(member).name

        def read(member: str = member, path: Path = path, stamp_ns: int = stamp_ns) -> Photo:
            return _told(photo_of(files.read(member, LARGEST_FILE), path), track, stamp_ns)

        yield ImportedImage(path.name, path, read)


def _beside(picture: ImportedImage, tracks: list[SensorTrack], assumed: Assumptions) -> ImportedImage:
    """Complete a photo with sensor data that was recorded at its time."""

    def read() -> Photo:
        photo = picture.read()
        stamp_ns = stamp_of_moment(photo_time(photo, None, assumed.time_zone, []))
        told = [_told(photo, track, stamp_ns) for track in tracks]
        placed = [one for one in (*told, photo) if one.sensed.lon is not None]
        return placed[0] if placed else told[0]

    return replace(picture, read=read)


def _told(photo: Photo, track: SensorTrack, stamp_ns: int) -> Photo:
    """Return the photo with the track's values at its time, completed by its EXIF."""
    return replace(photo, sensed=track.at(stamp_ns, _held(photo, track, stamp_ns)).over(photo.sensed))


def _held(photo: Photo, track: SensorTrack, stamp_ns: int) -> Float64Array:
    """Return (3, 3): the upright photo's optical frame to the phone's axes, by how it was held.

    EXIF's orientation decides; else a portrait was held upright, and a landscape on the side that makes it so."""
    stated = photo.exif.orientation
    turned = (_TURNED_DEG[stated],) if stated != 1 and stated in _TURNED_DEG else ()
    rotation = track.rotation_at(stamp_ns)
    return held_phone(None if rotation is None else rotation.as_matrix(), photo.height > photo.width, turned)
