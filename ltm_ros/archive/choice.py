"""Chooses the frames of an archive that a sample takes, and keeps each choice: no picture is looked at twice."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence

from ltm_core.site import Site
from ltm_ros.archive.content_digest import code_digest, digest, look_digest
from ltm_ros.archive.files import ArchiveFiles
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.pictures import PictureReader, SmallLook
from ltm_ros.archive.results import ResultFolder
from ltm_ros.archive.sampling import Sample, daylight_ns, in_daylight, place_of, repeated, sampled, span_number, spans

LOOKS = "looks"
REPEATED = "repeated: the camera had sent the same picture before"


def chosen(
    frames: Sequence[ArchiveFrame],
    within: tuple[int, int],
    sample: Sample,
    site: Site,
    results: ResultFolder,
    files: ArchiveFiles,
) -> tuple[list[ArchiveFrame], Counter[str]]:
    """Of all `frames` of an archive, by camera and stamp, those of the sample with stamps `within`, both inclusive; and
    how many pictures were passed over, by reason. Raises ArchiveError, OSError where a picture cannot be read just now.
    """
    longitude, _ = place_of(site)
    still = repeated(frames, longitude)
    taken, passed = list[ArchiveFrame](), Counter[str]()
    asked = [frame for frame in frames if within[0] <= frame.stamp_ns <= within[1]]
    with PictureReader(files) as reader:
        looks = {camera: SmallLook(site, camera, reader) for camera in {frame.camera for frame in asked}}
        for span in spans(in_daylight(asked, site), sample, longitude):
            new = [frame for frame in span if (frame.camera, frame.stamp_ns) not in still]
            if repeats := len(span) - len(new):
                passed[REPEATED] += repeats
            camera = span[0].camera
            turn = span_number(span[0].stamp_ns, sample, longitude)
            lit = daylight_ns(turn, sample, site)
            when = [sample.described, turn, lit]
            of = [code_digest(), look_digest(site, camera), *when, [frame.identity() for frame in new]]
            name = f"{LOOKS}/{digest(*of)}.json"
            if not results.has(name):
                found = sampled(new, sample, looks[camera], turn, lit)
                kept = {"stamps": [frame.stamp_ns for frame in found.frames], "passed_over": found.passed_over}
                results.write(name, json.dumps(kept).encode())
            known = json.loads(results.read(name))
            stamps = set(known["stamps"])
            taken += [frame for frame in new if frame.stamp_ns in stamps]
            passed.update(known["passed_over"])
    return taken, passed
