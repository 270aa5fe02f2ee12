"""Check before any process starts what a graph needs: site, node parameters, folders, ports and disk space."""

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import get_context
from pathlib import Path

from pydantic import BaseModel

from ltm_core.base.errors import ConfigError, LtmError, SiteFinding, SiteVerdict
from ltm_core.raster.dem import prepare_heights
from ltm_core.site.site import Site
from ltm_core.site.site_check import SiteCheck, check_site
from ltm_core.site.site_io import load_site
from ltm_core.storage.config_io import checked
from ltm_core.storage.disk_io import free_bytes, require_folder
from ltm_core.vision.manifest import NetworkManifest
from ltm_ros.cameras.opening import doubts_of
from ltm_ros.cameras.protocols.credentials import read_secret
from ltm_ros.launching import shared_memory
from ltm_ros.launching.graph import Wanted, describe
from ltm_ros.runtime.handler import EX_CONFIG
from ltm_ros.runtime.topics import TF, transform_topics
from ltm_ros.runtime.web_server import bind_error, refusal

LEAST_SPACE = 200 << 20
"""Minimum free disk space in bytes."""
SCARCE_SPACE = 2 << 30
MACHINE = "machine"
"""Area of findings about the machine, not the site file; they may change."""
_LOOPBACK = "127.0.0.1"


Folders = Mapping[str, Path]
"""Folders for stored data, by purpose."""


def examine(path: Path, wanted: Wanted, folders: Folders | None = None) -> SiteCheck:
    """Check everything that the site file names, and what the machine must provide for its graph."""
    check = check_site(path, wanted.get("cameras", ()))
    if check.site is not None:
        check.findings += _nodes(check.site, path, wanted)
        check.findings += _places(check.site, wanted, folders or {})
        check.findings += _sources(check.site, wanted.get("cameras", ()))
        check.findings += _alerts(check.site)
    return check


class NotReadyError(ConfigError):
    """The graph cannot start; one line per error. `status`: see `exit_status`."""

    def __init__(self, findings: Sequence[SiteFinding]) -> None:
        wrong = (finding for finding in findings if finding.verdict is SiteVerdict.WRONG)
        super().__init__("\n".join(f"{finding.area}, {finding.name}: {finding.said}" for finding in wrong))
        self.status = exit_status(findings)


def require_ready(path: Path, wanted: Wanted, tell: Callable[[str], None], folders: Folders | None = None) -> Site:
    """Return the site if its graph can start. `tell` takes one line per warning. Raises NotReadyError."""
    findings = examined_apart(path, wanted, folders)
    if exit_status(findings):
        raise NotReadyError(findings)
    for finding in findings:
        if finding.verdict is SiteVerdict.DOUBTFUL:
            tell(f"warning: {finding.area}, {finding.name}: {finding.said}")
    return load_site(path)


def examined_apart(path: Path, wanted: Wanted, folders: Folders | None = None) -> list[SiteFinding]:
    """Return the findings of `examine`, made in a separate process, so that the long-running parent does not keep the
    memory of the DEM. If that process is killed, this is the finding."""
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(_findings, path, wanted, folders).result()
    except BrokenProcessPool:
        said = "the check was killed; the DEM may be larger than the memory. Clip it and add coarser rasters around it"
        return [SiteFinding(MACHINE, "memory", SiteVerdict.WRONG, said)]


def exit_status(findings: Sequence[SiteFinding]) -> int:
    """Return 0 without errors, EX_CONFIG if the site file must be corrected, so that systemd does not retry
    (`RestartPreventExitStatus=78`), or 1 if only this machine is not ready."""
    areas = {finding.area for finding in findings if finding.verdict is SiteVerdict.WRONG}
    return EX_CONFIG if areas - {MACHINE} else 1 if areas else 0


def _findings(path: Path, wanted: Wanted, folders: Folders | None) -> list[SiteFinding]:
    """Check a graph that is about to start; a large DEM is prepared first, so that its processes share it. The check
    reports errors of the site or the raster."""
    prepared: list[SiteFinding] = []
    with suppress(LtmError):
        dem = load_site(path).dem
        try:
            if (place := prepare_heights(dem.path, dem.crs)) is not None:
                prepared.append(_machine("dem", f"prepared in {place}: the processes share it"))
        except OSError as error:
            why = error.strerror or error
            prepared.append(_machine("dem", f"no file beside {dem.path} ({why}): each process loads its own copy"))
    return [*examine(path, wanted, folders).findings, *prepared]


def _machine(name: str, said: str, fine: bool = True, bad: SiteVerdict = SiteVerdict.DOUBTFUL) -> SiteFinding:
    """Return a finding about the machine."""
    return SiteFinding(MACHINE, name, SiteVerdict.OK if fine else bad, said)


def _nodes(site: Site, path: Path, wanted: Wanted) -> Iterator[SiteFinding]:
    """Check the parameters of each node type as the node does."""
    try:
        graph = describe(site, path, **wanted)
    except LtmError as error:
        yield SiteFinding.of("site", "nodes", error)
        return
    wrong = False
    for spec in {spec.module: spec for spec in graph}.values():
        given = {name: value for name, value in spec.parameters.items() if name != "use_sim_time"}
        module = importlib.import_module(spec.module)
        config: type[BaseModel] = module.NODE.config if hasattr(module, "NODE") else module.CONFIG
        try:
            checked(config, given, f"nodes.{spec.executable}")
            if name := given.get("model"):
                NetworkManifest.find(str(name)).require(spec.executable == "topodepth")
        except LtmError as error:
            wrong = True
            yield SiteFinding.of("site", "nodes", error)
    count = len(graph.processes)
    if not wrong:
        said = f"{len(graph)} nodes in {count} processes, parameters are valid"
        yield SiteFinding("site", "nodes", SiteVerdict.OK, said)
    needed, free = shared_memory.BYTES_PER_PARTICIPANT * (count + 1), shared_memory.free_bytes()
    if free is not None:
        remedy = ": images will be slow or lost; enlarge it (mount -o remount,size=2G /dev/shm)" * (free < needed)
        said = f"{free >> 20} MB free, {count} processes need {needed >> 20} MB{remedy}"
        yield _machine(str(shared_memory.SHM_FOLDER), said, free >= needed)


def _places(site: Site, wanted: Wanted, named: Folders) -> Iterator[SiteFinding]:
    folders = dict(named)
    for kind in ("fuel_map", "terrain", "uplink"):
        folder = site.nodes.get(kind, {}).get("folder")
        if isinstance(folder, str):
            folders.setdefault(f"data of {kind}", Path(folder))
    for what, place in folders.items():
        try:
            require_folder(place.expanduser(), what)
        except LtmError as wrong:
            yield SiteFinding.of(MACHINE, what, wrong)
            continue
        free = free_bytes(place.expanduser())
        remedy = ": free some space, or give a folder on another disk" * (free < SCARCE_SPACE)
        bad = SiteVerdict.WRONG if free < LEAST_SPACE else SiteVerdict.DOUBTFUL
        yield _machine(what, f"{place}: {free / 1e9:.1f} GB free{remedy}", free >= SCARCE_SPACE, bad)
    if (view := wanted.get("view")) is not None:
        given = dict(site.nodes.get("viewer", {})) | dict(view)
        for name, usual in (("web_port", 9090), ("grpc_port", 9876)):
            port = given.get(name, usual)
            if isinstance(port, int) and port:
                error = bind_error(_LOOPBACK, port)
                why = f"in use ({error.strerror}): end the program that uses it, or set another" if error else "free"
                said = f"port {port} on {_LOOPBACK} is {why}{f' (nodes.viewer.{name})' if error else ''}"
                yield _machine(name, said, error is None, SiteVerdict.WRONG)
    if wanted.get("health") is not None and (health := site.health) is not None and health.port:
        # Only a warning, because the tower runs without it and retries.
        error = bind_error(health.address, health.port)
        said = f"{health.port} on {health.address} is free"
        if error is not None:
            said = f"{refusal(health.address, health.port, error)}; the tower runs, and retries"
        yield _machine("health", said, error is None)


def _sources(site: Site, cameras: Sequence[str]) -> Iterator[SiteFinding]:
    """Check cameras; nothing that they lack keeps a graph from starting, because requests are repeated."""
    for name in cameras or site.cameras:
        moving, _ = transform_topics(site.cameras[name])
        if moving and TF is None:
            lacks = f"{moving} is read in replays only: tf2_msgs is not installed; use ROS 2 from apt, or another pose"
            yield _machine(f"pose of {name}", lacks, False)
        if (source := site.cameras[name].source) is None:
            continue
        doubts = list(doubts_of(source))
        yield from (_machine(f"source of {name}", doubt, False) for doubt in doubts)
        if not doubts:
            yield SiteFinding("cameras", f"source of {name}", SiteVerdict.OK, source.kind)


def _alerts(site: Site) -> Iterator[SiteFinding]:
    """Check that the secrets of receivers can be read; a tower starts without, because messages are sent again."""
    if (alerts := site.alerts) is None:
        return
    for name, given in (("token", alerts.token), ("password", alerts.password)):
        try:
            if given is not None:
                read_secret(given)
        except LtmError as error:
            yield _machine(f"alerts.{name}", str(error), False)
