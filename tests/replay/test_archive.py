"""`ltm reprocess`: whatever works an archive, in whatever parts, its map is that of the serial offline replay."""

import errno
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.records import Chunk
from scenes.archive_jobs import deadly_work
from scenes.own_disk import run_on_own_disk
from scenes.small_site import BEGIN_NS, FRAMES, NAME, SmallSite
from typer.testing import CliRunner

from ltm_core.base.errors import ArchiveError
from ltm_core.base.resources import config_path
from ltm_core.base.types import Int16Array
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.site.site import Site
from ltm_core.storage.tile_store import TileStore
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_ros.archive import run as archive_run
from ltm_ros.archive.manifest import ArchiveImageReader
from ltm_ros.archive.reduction import store_digest
from ltm_ros.archive.run import ArchiveOptions, Summary, look_through, run
from ltm_ros.archive.sampling import REPEATED, Sample
from ltm_ros.archive.task import Engine, FrameSteps, on_workers, serial, work
from ltm_ros.cli.main import cli
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline
from ltm_ros.runtime.topics import IMAGE_COMPRESSED, camera_topic

DISK_PROCESS = Path(__file__).parents[1] / "scenes" / "archive_disk_process.py"


def digest_of(store: Path) -> str:
    with TileStore.open_read_only(store, STORE_KIND) as opened:
        return store_digest(opened)


def replayed(bag: Path, site: Path, folder: Path) -> str:
    folder.mkdir()
    run_offline(bag, site, ReplayOptions(state=folder), lambda done, total: None)
    return digest_of(folder / STORE_FILE)


def reprocessed(options: ArchiveOptions, engine: Engine = serial) -> Summary:
    return run(look_through(options, lambda done, total: None), engine, lambda done, total: None)


@pytest.fixture(scope="module")
def expected(small_site: SmallSite, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The digest of the offline replay's store."""
    return replayed(small_site.bag, small_site.path, tmp_path_factory.mktemp("replay") / "state")


@pytest.fixture(scope="module")
def done(small_site: SmallSite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `ltm reprocess` makes of the small site's recording."""
    out = tmp_path_factory.mktemp("done") / "out"
    reprocessed(ArchiveOptions((small_site.bag,), small_site.path, out))
    return out


@pytest.fixture
def options(small_site: SmallSite, tmp_path: Path) -> ArchiveOptions:
    return ArchiveOptions((small_site.bag,), small_site.path, tmp_path / "out")


@pytest.fixture
def resumed(options: ArchiveOptions, done: Path) -> ArchiveOptions:
    """Where all results are there already."""
    shutil.copytree(done, options.out)
    return options


def test_any_chunks_give_the_map_of_the_offline_replay(options: ArchiveOptions, expected: str, done: Path) -> None:
    assert digest_of(done / STORE_FILE) == expected
    summary = reprocessed(replace(options, frames_per_task=4))
    assert summary.digest == expected
    assert (summary.worked, summary.merged, summary.failed) == (2 * FRAMES, 2 * FRAMES, 0)
    assert digest_of(options.out / STORE_FILE) == expected
    assert summary.tasks == 2 * 2


def test_a_run_that_was_stopped_goes_on(options: ArchiveOptions, expected: str) -> None:
    options = replace(options, frames_per_task=2)

    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(look_through(options, lambda done, total: None), serial, stop)
    assert not (options.out / STORE_FILE).exists()
    summary = reprocessed(options)
    assert (summary.digest, summary.worked) == (expected, 2 * FRAMES - 4)


@pytest.fixture
def own_site(small_site: SmallSite, tmp_path: Path) -> SmallSite:
    """To be changed."""
    shutil.copytree(small_site.folder, tmp_path / "site")
    return SmallSite(tmp_path / "site")


def edited(site: SmallSite, change: Callable[[dict[str, Any]], None]) -> None:
    content = yaml.safe_load(site.path.read_text())
    change(content)
    site.path.write_text(yaml.safe_dump(content))


def test_a_corrected_pose_works_that_camera_alone(own_site: SmallSite, tmp_path: Path) -> None:
    options = ArchiveOptions((own_site.bag,), own_site.path, tmp_path / "out")
    before = reprocessed(options)
    edited(own_site, lambda site: site["cameras"]["mast"]["pose"].update(azimuth_deg=49.0))
    after = reprocessed(options)
    assert (before.worked, after.worked) == (2 * FRAMES, FRAMES)
    assert after.digest == replayed(own_site.bag, own_site.path, tmp_path / "state") != before.digest
    edited(own_site, lambda site: site["cameras"]["mast"]["pose"].update(azimuth_deg=48.0))
    back = reprocessed(options)
    assert (back.worked, back.digest) == (0, before.digest)


def test_archives_that_hold_the_same_frames_count_them_once(
    options: ArchiveOptions, expected: str, small_site: SmallSite, tmp_path: Path
) -> None:
    shutil.copytree(small_site.bag, tmp_path / "copy")
    planned = look_through(replace(options, archives=(small_site.bag, tmp_path / "copy")), lambda done, total: None)
    assert planned.manifest.repeated == 2 * FRAMES
    assert run(planned, serial, lambda done, total: None).digest == expected


def test_pictures_that_repeat_the_last_one_are_no_frames_where_the_site_says_so(
    own_site: SmallSite, tmp_path: Path
) -> None:
    """The mast's pictures are all the same; the map is that of the replay, whose capture leaves them out too."""
    edited(own_site, lambda site: site["nodes"]["capture"].update(drop_repeated=True))
    options = ArchiveOptions((own_site.bag,), own_site.path, tmp_path / "out")
    summary = reprocessed(options)
    assert (summary.merged, summary.failed) == (FRAMES + 1, 0)
    assert summary.digest == replayed(own_site.bag, own_site.path, tmp_path / "state")
    record = json.loads((options.out / "run.json").read_text())
    assert record["frames"]["unchanged"] == FRAMES - 1


def rewritten(source: Path, target: Path, change: Callable[[int, bytes], bytes]) -> Path:
    """A bag whose tower's pictures are changed: their number from 0 on and bytes, to bytes."""
    topic, number = camera_topic(NAME, "tower", IMAGE_COMPRESSED), 0
    with BagWriter(target) as bag:
        for message in BagReader(source).messages():
            raw = message.raw
            if message.topic == topic:
                raw = change(number, raw)
                number += 1
            bag.write_raw(message.topic, message.type_name, raw, message.log_time_ns)
    return target


def test_a_damaged_picture_is_named_and_no_map_written_above_the_share(
    options: ArchiveOptions, small_site: SmallSite, tmp_path: Path
) -> None:
    def spoiled(number: int, raw: bytes) -> bytes:
        return raw if number != 2 else raw[: len(raw) // 2] + b"\0" * (len(raw) - len(raw) // 2)

    bag = rewritten(small_site.bag, tmp_path / "spoiled", spoiled)
    options = replace(options, archives=(bag,))
    with pytest.raises(ArchiveError, match="1 of 12 frames failed"):
        reprocessed(options)
    assert not (options.out / STORE_FILE).exists()
    record = json.loads((options.out / "run.json").read_text())
    assert record["frames"]["failed"] == 1
    assert "truncated" in record["failures"][0]["why"]
    summary = reprocessed(replace(options, max_failed=0.1))
    assert summary.digest == replayed(bag, small_site.path, tmp_path / "state")
    assert (summary.merged, summary.failed) == (2 * FRAMES - 1, 1)
    with pytest.raises(ArchiveError, match="1 of 12 frames failed"):
        reprocessed(options)  # though a map is there that was made with more patience


def test_a_cut_recording_gives_what_it_has(options: ArchiveOptions, small_site: SmallSite, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "small_chunks", chunk_size=20_000) as bag:
        for message in BagReader(small_site.bag).messages():
            bag.write_raw(message.topic, message.type_name, message.raw, message.log_time_ns)
    whole = next((tmp_path / "small_chunks").glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    summary = reprocessed(replace(options, archives=(cut,), max_failed=0.5))
    assert 2 <= summary.merged < 2 * FRAMES
    assert summary.digest == replayed(cut, small_site.path, tmp_path / "state")
    record = json.loads((options.out / "run.json").read_text())
    assert "cut.mcap is truncated" in record["damage"][0] or "without a footer" in record["damage"][0]


def test_clocks_that_stand_still_jump_or_were_never_set(own_site: SmallSite, tmp_path: Path) -> None:
    """Five days without a frame, then a clock that is set back by an hour, then one that begins in 1970: frames count
    by their stamps as in the replay, gaps are told before the run, and what has no time is named."""
    day, hour = 86_400 * 10**9, 3600 * 10**9
    first = own_site.write_bag(tmp_path / "first", 2)
    later = own_site.write_bag(tmp_path / "later", 2, BEGIN_NS + 6 * day)
    back = moved(own_site.write_bag(tmp_path / "made", 2, BEGIN_NS + 6 * day - hour), tmp_path / "back", 2 * hour)
    unset = moved(own_site.write_bag(tmp_path / "early", 1, 5 * 10**9), tmp_path / "unset", BEGIN_NS + 7 * day)
    bags = (first, later, back, unset)
    options = ArchiveOptions(bags, own_site.path, tmp_path / "out", max_failed=0.2)
    summary = reprocessed(options)
    assert (summary.merged, summary.failed) == (12, 2)
    assert {failure.cause for failure in summary.failures} == {"unset_clock"}
    (tmp_path / "state").mkdir()
    for bag in bags:
        run_offline(bag, own_site.path, ReplayOptions(state=tmp_path / "state"), lambda done, total: None)
    assert summary.digest == digest_of(tmp_path / "state" / STORE_FILE)
    command = ["reprocess", *map(str, bags), "--site", str(own_site.path), "--out", str(tmp_path / "dry"), "--dry-run"]
    tried = CliRunner().invoke(cli, command, env={"COLUMNS": "160"})
    assert tried.exit_code == 0, tried.output
    about = [line.split()[1:8:2] for line in tried.output.splitlines() if "tower" in line or "mast" in line]
    assert ["mast", "6", "2", "5"] in about
    assert "unset_clock" in tried.output


def moved(bag: Path, target: Path, by_ns: int) -> Path:
    """Logged so much later than it was taken."""
    with BagWriter(target) as written:
        for message in BagReader(bag).messages():
            written.write_raw(message.topic, message.type_name, message.raw, message.log_time_ns + by_ns)
    return target


def test_a_store_that_a_node_went_on_from_is_not_written_over(resumed: ArchiveOptions) -> None:
    with (Path(resumed.out) / STORE_FILE).open("ab") as store:
        store.write(b"more")
    with pytest.raises(ArchiveError, match="a node may have continued from it"):
        reprocessed(resumed)


def test_a_store_of_our_own_is_written_over_after_runs_that_failed_or_were_killed(
    options: ArchiveOptions, small_site: SmallSite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected: str
) -> None:
    reprocessed(replace(options, cameras=("mast",)))
    bag = rewritten(small_site.bag, tmp_path / "cut", lambda number, raw: raw if number != 2 else raw[: len(raw) // 2])
    with pytest.raises(ArchiveError, match="no map was written"):
        reprocessed(replace(options, archives=(bag,)))
    written = archive_run.write_result

    def killed(path: Path, content: bytes) -> None:
        if path.name == "run.json":
            raise KeyboardInterrupt
        written(path, content)

    with monkeypatch.context() as patched:
        patched.setattr(archive_run, "write_result", killed)
        with pytest.raises(KeyboardInterrupt):
            reprocessed(replace(options, cameras=("tower",)))
    assert reprocessed(options).digest == expected


def test_an_archive_that_is_away_loses_no_frame_for_good(
    options: ArchiveOptions, small_site: SmallSite, tmp_path: Path, expected: str
) -> None:
    """As a network's file system that is not mounted for a while."""
    shutil.copytree(small_site.bag, tmp_path / "bag")
    options = replace(options, archives=(tmp_path / "bag",))
    planned = look_through(options, lambda done, total: None)
    (tmp_path / "bag").rename(tmp_path / "away")
    with pytest.raises(ArchiveError, match=r"12 of 12 frames failed \(12 task\)"):
        run(planned, serial, lambda done, total: None)
    (tmp_path / "away").rename(tmp_path / "bag")
    assert reprocessed(options).digest == expected


def test_a_live_node_goes_on_from_the_store(resumed: ArchiveOptions, small_site: SmallSite, expected: str) -> None:
    """It opens it, shows what it holds, and takes none of its frames again."""
    out = Path(resumed.out)
    summaries = run_offline(small_site.bag, small_site.path, ReplayOptions(state=out), lambda done, total: None)
    assert summaries[f"/{NAME}/fuel_map"]["dropped.duplicate"] == str(2 * FRAMES)
    assert digest_of(out / STORE_FILE) == expected


def test_the_journal_tells_the_end_of_each_day(small_site: SmallSite, tmp_path: Path) -> None:
    day = 86_400 * 10**9
    bags = tuple(small_site.write_bag(tmp_path / f"day_{number}", 2, BEGIN_NS + number * day) for number in range(2))
    options = ArchiveOptions(bags, small_site.path, tmp_path / "out")
    summary = reprocessed(options)
    assert (summary.tasks, summary.merged) == (4, 8)
    with TileStore.open_read_only(tmp_path / "out" / STORE_FILE, STORE_KIND) as store:
        days = {change.stamp_ns // day for change in store.changes("life_form")}
    assert days <= {BEGIN_NS // day, BEGIN_NS // day + 1}
    assert BEGIN_NS // day in days
    only = reprocessed(replace(options, since_ns=BEGIN_NS + day))
    assert only.merged == 4


def test_burns_are_told_when_they_come(small_site: SmallSite, tmp_path: Path) -> None:
    """Of three days, the second burns between two of its frames, and the day after the last without any frames. The map
    is that of one that counts all frames in their order and is told at these moments."""
    day, site = 86_400 * 10**9, small_site.site
    bags = tuple(small_site.write_bag(tmp_path / f"day_{n}", 3, BEGIN_NS + n * day) for n in range(3))
    # Frames of a day are in its seconds 0 and, of the mast, 0.1 to 0.6: later ones are in the next second.
    later = small_site.write_bag(tmp_path / "later", 2, BEGIN_NS + day + 5 * 10**9)
    geometry = site.fuel_geometry(site.open_dem())
    areas = {BEGIN_NS + day + 3 * 10**9: (2, 30), BEGIN_NS + 3 * day: (20, 26)}
    features = []
    for stamp, (first, last) in areas.items():
        edge = site.in_crs(geometry)
        corners = [(c, r) for c, r in ((first, 0), (last, 0), (last, 20), (first, 20), (first, 0))]
        x = [edge.x_min + c * edge.resolution - site.frame.x_origin for c, _ in corners]
        y = [edge.y_max - r * edge.resolution - site.frame.y_origin for _, r in corners]
        ring = [list(map(float, site.frame.to_lonlat(*point))) for point in zip(x, y, strict=True)]
        moment = str(np.datetime64(stamp, "ns").astype("datetime64[s]"))
        geometry_of = {"type": "Polygon", "coordinates": [ring]}
        features.append({"type": "Feature", "properties": {"burned_at": moment}, "geometry": geometry_of})
    (tmp_path / "burns.json").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    options = ArchiveOptions((*bags, later), small_site.path, tmp_path / "out", frames_per_task=2)
    unburned = reprocessed(options)
    shutil.copy(tmp_path / "out" / STORE_FILE, tmp_path / "unburned.ltm")
    planned = look_through(replace(options, burns=tmp_path / "burns.json"), lambda done, total: None)
    summary = run(planned, serial, lambda done, total: None)
    assert (summary.worked, summary.merged) == (0, unburned.merged), "votes do not depend on burns"
    labels = LabelSet.load(config_path(site.labels))
    live, votes = site_evidence_map(site, geometry, labels), []
    rules, reader = planned.settings, ArchiveImageReader()
    for camera in site.cameras:
        steps = FrameSteps(site, camera, rules.tracing, rules.labelling)
        for frame in (one for one in planned.frames if one.camera == camera):
            found, _ = steps.votes(frame, reader.read(frame).rgb())
            votes.append(found)
    waiting = list(planned.burns)
    assert [burn.stamp_ns for burn in waiting] == list(areas)
    for frame in sorted(votes, key=lambda frame: frame.stamp_ns):
        while waiting and waiting[0].stamp_ns <= frame.stamp_ns:
            burn = waiting.pop(0)
            live.burn(burn.mask(geometry.shape), burn.stamp_ns)
        live.add(frame)
    live.burn(waiting[0].mask(geometry.shape), waiting[0].stamp_ns)
    with TileStore.open_read_only(tmp_path / "out" / STORE_FILE, STORE_KIND) as store:
        stored = dict(store.tiles())
        assert set(stored) >= {(0, 0)}
        for key, tile in stored.items():
            for name, values in live.tile_state(key).items():
                np.testing.assert_array_equal(tile[name], values, err_msg=f"{key} {name}")
        burned = journal_of(store, site)
    with TileStore.open_read_only(tmp_path / "unburned.ltm", STORE_KIND) as store:
        never = journal_of(store, site)
    np.testing.assert_array_equal(burned[0], never[0])
    last = planned.burns[1].mask(geometry.shape)
    assert (burned[4][last] != burned[2][last]).any()
    np.testing.assert_array_equal(burned[4], live.layers().code)


def journal_of(store: TileStore, site: Site) -> list[Int16Array]:
    """Codes at the end of a day from the first on."""
    geometry = site.fuel_geometry(site.open_dem())
    initial = site_evidence_map(site, geometry, LabelSet.load(config_path(site.labels))).layers().code
    day = 86_400 * 10**9
    return [store.as_of("code", initial, (BEGIN_NS // day + number + 1) * day - 1) for number in range(5)]


def test_a_sample_is_worked_alone_and_looked_at_once(options: ArchiveOptions) -> None:
    """The mast's images are all the same."""
    options = replace(options, sample=Sample.parsed("2/day"))
    planned = look_through(options, lambda done, total: None)
    assert [frame.camera for frame in planned.frames] == ["mast", "tower", "tower"]
    assert planned.passed_over == {REPEATED: FRAMES - 1}
    assert run(planned, serial, lambda done, total: None).merged == 3
    looks = sorted((options.out / "looks").iterdir())
    changed = [file.stat().st_mtime_ns for file in looks]
    again = look_through(options, lambda done, total: None)
    assert [frame.identity() for frame in again.frames] == [frame.identity() for frame in planned.frames]
    assert [file.stat().st_mtime_ns for file in looks] == changed


def test_layers_and_their_catalogue_entry_are_written(done: Path) -> None:
    layers = done / "layers"
    item = json.loads((layers / "item.stac.json").read_text())
    assert item["properties"]["datetime"] == "2023-11-14T22:13:21Z"
    assert {(layers / asset["href"]).is_file() for asset in item["assets"].values()} == {True}


def test_a_program_or_files_that_have_changed_during_the_run_are_refused(options: ArchiveOptions) -> None:
    planned = look_through(options, lambda done, total: None)
    with pytest.raises(ArchiveError, match="the program"):
        work(planned.tasks[0], replace(planned.settings, code="another"))
    with pytest.raises(ArchiveError, match="a file that it names"):
        work(replace(planned.tasks[0], site_key="another"), planned.settings)


def test_a_site_whose_poses_hang_on_the_order_of_frames_is_refused(own_site: SmallSite, tmp_path: Path) -> None:
    edited(own_site, lambda site: site.update(refine_poses={}))
    with pytest.raises(ArchiveError, match="refines poses"):
        look_through(ArchiveOptions((own_site.bag,), own_site.path, tmp_path / "out"), lambda done, total: None)


def test_command_line(small_site: SmallSite, tmp_path: Path, expected: str) -> None:
    command = ["reprocess", str(small_site.bag), "--site", str(small_site.path), "--out", str(tmp_path / "out")]
    tried = CliRunner().invoke(cli, [*command, "--dry-run"], env={"COLUMNS": "160"})
    assert tried.exit_code == 0, tried.output
    assert "12 frames in 2 tasks" in tried.output
    assert not (tmp_path / "out" / STORE_FILE).exists()
    done = CliRunner().invoke(cli, [*command, "--workers", "0"], env={"COLUMNS": "160"})
    assert done.exit_code == 0, done.output
    assert "12 frames processed now, 12 in the map, 0 failed" in done.output
    assert expected in done.output.replace("\n", "")


@pytest.mark.slow
def test_a_task_that_kills_its_workers_is_named_and_the_others_end(small_site: SmallSite, tmp_path: Path) -> None:
    """As a decoder's fault does, or too little memory."""
    options = ArchiveOptions((small_site.bag,), small_site.path, tmp_path / "out", frames_per_task=3)
    deadly = look_through(options, lambda done, total: None).tasks[0]
    with pytest.raises(ArchiveError, match=r"3 of 12 frames failed \(3 task\)"):
        reprocessed(options, on_workers(2, partial(deadly_work, deadly.key)))
    record = json.loads((tmp_path / "out/run.json").read_text())
    assert [failure["place"] for failure in record["failures"]] == [deadly.label]
    assert "several workers died of it" in record["failures"][0]["why"]
    assert reprocessed(options).worked == 3


def test_a_disk_that_fails_for_a_while_is_no_result(
    small_site: SmallSite, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a network's file system does: chunks of a recording that cannot be read are not chunks that are broken."""

    def failing(stream: object) -> Chunk:
        raise OSError(errno.EIO, "Input/output error")

    options = ArchiveOptions((small_site.bag,), small_site.path, tmp_path / "out", max_failed=1.0)
    with monkeypatch.context() as patched:
        patched.setattr(Chunk, "read", failing)
        with pytest.raises(ArchiveError, match=r"cannot be read now: .*Input/output error"):
            reprocessed(options)
    planned = look_through(options, lambda done, total: None)
    with monkeypatch.context() as patched:
        patched.setattr(Chunk, "read", failing)
        with pytest.raises(ArchiveError, match="Input/output error"):
            run(planned, serial, lambda done, total: None)
    assert reprocessed(options).digest == expected


def test_a_disk_that_fills_up_while_a_run_writes_is_named_and_the_run_goes_on_when_there_is_room(
    small_site: SmallSite, expected: str, tmp_path: Path
) -> None:
    (tmp_path / "disk").mkdir()
    found = run_on_own_disk(DISK_PROCESS, "full", tmp_path / "disk", small_site.folder)
    assert "No space left on device" in found["said"]
    assert (found["maps"], found["partial"]) == ([], []), "no map, and no file that is not whole"
    assert (found["digest"], found["frames"]) == (expected, 2 * FRAMES)
    assert 0 < found["worked"] < 2 * FRAMES, "what was done before stays done"
