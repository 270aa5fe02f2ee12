"""Choose the frames of an archive that a sample takes, and store each choice.

Frames of one view within a day are nearly equal, so a few of them are enough. A day or hour is divided into equal
times, and each gives one clear image in daylight. The search begins at another place in each span, so that several days
cover all hours. An image that the camera sent before, in the same span or the last one, does not count."""

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ltm_core.base.errors import ArchiveError, LtmError
from ltm_core.base.number_text import DAY_NS
from ltm_core.geometry.geodesy import sun_elevation
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site import Site
from ltm_core.vision.masks import Looking
from ltm_core.vision.scene_view import SceneFilter
from ltm_ros.archive.manifest import ArchiveFrame, ArchiveImageReader
from ltm_ros.archive.plan import code_digest, seen_by_content
from ltm_ros.archive.scan import digest, write_result

_SPANS = {"hour": DAY_NS // 24, "day": DAY_NS}
_ASKED = 4
"""Maximum number of images that are checked per sampled frame."""
_GOLDEN = (math.sqrt(5) - 1) / 2
LOOKS = "looks"
REPEATED = "repeated: the camera sent the same image before"

Look = Callable[[ArchiveFrame], str]
"""Returns why a frame's image is unusable; empty: it is clear."""


@dataclass(frozen=True)
class Sample:
    """`count` frames of each camera per `span` (hour, day); 0: all."""

    count: int = 0
    span: str = "day"

    @classmethod
    def parsed(cls, text: str) -> "Sample":
        """Parse `all`, `4/day` or `1/hour`. Raises ArchiveError."""
        if text == "all":
            return cls()
        found = re.fullmatch(r"([1-9][0-9]*)/(hour|day)", text)
        if found is None:
            raise ArchiveError(f"sample {text!r}: give all, or a number per time span such as 4/day or 1/hour")
        return cls(int(found[1]), found[2])

    @property
    def described(self) -> str:
        return f"{self.count}/{self.span}" if self.count else "all"


def sampled(frames: Sequence[ArchiveFrame], count: int, look: Look, turn: int) -> tuple[list[ArchiveFrame], list[str]]:
    """Choose at most `count` clear frames of the span number `turn`, by stamp; also return why others were rejected."""
    parts: dict[int, list[ArchiveFrame]] = {}
    for frame in frames:
        first, last = frames[0].stamp_ns, frames[-1].stamp_ns
        parts.setdefault((frame.stamp_ns - first) * count // (last - first + 1), []).append(frame)
    taken, reasons = [], []
    for part in parts.values():
        begin, step = int(turn * _GOLDEN % 1 * len(part)), max(1, len(part) // _ASKED)
        for tried in range(min(_ASKED, len(part))):
            frame = part[(begin + tried * step) % len(part)]
            reason = look(frame)
            if not reason:
                taken.append(frame)
                break
            reasons.append(reason)
    return taken, reasons


def spans(frames: Sequence[ArchiveFrame], sample: Sample, site: Site) -> dict[tuple[str, int], list[ArchiveFrame]]:
    """Return the frames in daylight by camera and number of their span; days begin at solar midnight. In a polar night,
    all frames count."""
    longitude, latitude = (math.radians(float(value)) for value in site.frame.to_lonlat(0.0, 0.0))
    shift = round(longitude / math.tau * DAY_NS)
    bright = sun_elevation(latitude, longitude, [frame.stamp_ns for frame in frames]) > 0
    days = [(frame.stamp_ns + shift) // DAY_NS for frame in frames]
    lit = {day for day, up in zip(days, bright, strict=True) if up}
    found: dict[tuple[str, int], list[ArchiveFrame]] = {}
    for frame, day, up in zip(frames, days, bright, strict=True):
        if up or day not in lit:
            number = (frame.stamp_ns + shift) // _SPANS[sample.span]
            found.setdefault((frame.camera, number), []).append(frame)
    return found


def chosen(
    frames: Sequence[ArchiveFrame], sample: Sample, site: Site, results: Path
) -> tuple[list[ArchiveFrame], Counter[str]]:
    """Choose a sample of frames, by camera and stamp; also count unclear images by reason. Raises ArchiveError,
    OSError."""
    taken, passed = list[ArchiveFrame](), Counter[str]()
    reader, former, before = ArchiveImageReader(), "", set[str]()
    for (camera, number), span in sorted(spans(frames, sample, site).items()):
        sent = set(before) if camera == former else set[str]()
        new = [frame for frame in span if not (frame.content in sent or sent.add(frame.content))]  # type: ignore[func-returns-value]
        former, before = camera, {frame.content for frame in span}
        passed[REPEATED] += len(span) - len(new)
        of = [code_digest(), seen_by_content(site, camera), sample.described, [frame.identity() for frame in new]]
        kept = results / LOOKS / f"{digest(number, *of)}.json"
        if not kept.exists():
            scene = site_scene_filter(site, camera)
            found, reasons = sampled(new, sample.count, partial(_look, scene, reader), number)
            about = {"stamps": [frame.stamp_ns for frame in found], "passed_over": reasons}
            write_result(kept, json.dumps(about).encode())
        known = json.loads(kept.read_bytes())
        taken += [frame for frame in new if frame.stamp_ns in known["stamps"]]
        passed.update(known["passed_over"])
    return taken, +passed


def _look(scene: SceneFilter, reader: ArchiveImageReader, frame: ArchiveFrame) -> str:
    picture = reader.read(frame)
    try:
        rgb = picture.rgb()
    except LtmError as error:
        return f"damaged: {error}"
    return scene.look(rgb, Looking.of(frame.calibration, frame.pose), frame.stamp_ns).unusable
