"""Open the networks and masks of a site's cameras: segmenters, scene filters, label errors."""

from contextlib import suppress
from pathlib import Path

import numpy as np

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.resources import config_path
from ltm_core.fuel.label_errors import LabelErrors, known_errors, labels_digest, record_file, stated_errors
from ltm_core.site.site import Site
from ltm_core.vision.label_head import find_label_head
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import RECORDS, SHIPPED_LABEL_HEAD, NetworkManifest
from ltm_core.vision.masks import MaskMaker
from ltm_core.vision.prompts import prompted
from ltm_core.vision.scene_view import SceneFilter
from ltm_core.vision.segmenter import Segmenter


def label_model(site: Site) -> str:
    """Return the network whose labels vote: that of the node `segmentation` in the site file, or the site's."""
    return str(site.nodes.get("segmentation", {}).get("model") or site.model)


def label_network(site: Site, model: str = "", shown: str = "") -> str | NetworkManifest:
    """Return the network that labels, or `model`: its name, or its manifest with the site's vocabulary.

    `shown`: a prompt of an operator, which becomes a class of its own. Raises ModelError, ConfigError as `prompted`."""
    name = model or label_model(site)
    if not (site.vocabulary or shown):
        return name
    return prompted(NetworkManifest.find(name), site.vocabulary, LabelSet.load(config_path(site.labels)), shown)


def site_label_errors(site: Site) -> LabelErrors:
    """Return the known label errors of the site's network. Raises ConfigError."""
    given = site.fuel.label_errors
    return known_errors(label_network(site)) if given is None else stated_errors(Path(given))


def camera_label_errors(site: Site) -> dict[str, LabelErrors]:
    """Return the label errors of cameras with their own label head, which differ from those of the network.

    Empty where the site file states its errors. Raises ConfigError; ModelError for a head that cannot be taken."""
    if site.fuel.label_errors is not None:
        return {}
    heads = {camera.label_head for camera in site.cameras.values()} - {SHIPPED_LABEL_HEAD}
    network = label_network(site) if heads else ""
    known = {head: known_errors(network, head, site.label_heads) for head in heads}
    return {name: known[camera.label_head] for name, camera in site.cameras.items() if camera.label_head in known}


def unmeasured_labels(site: Site) -> str | None:
    """Return the digest of the labels of all cameras if they are the same and unmeasured; None otherwise, and for a
    network or label head that is not installed here. Raises ConfigError for an invalid record."""
    heads = {camera.label_head for camera in site.cameras.values()}
    if len(heads) != 1 or site.fuel.label_errors is not None:
        return None
    head = heads.pop()
    with suppress(ModelError):
        model = label_network(site)
        if not known_errors(model, head, site.label_heads).measured:
            manifest = NetworkManifest.find(model).serving(head)
            return labels_digest(manifest, find_label_head(head, manifest, site.label_heads))
    return None


def with_live_record(site: Site, folder: Path | None) -> Site:
    """Return the site with the label errors that its fuel map, which is kept in `folder`, has measured itself; the same
    site if there are none or if better ones are known. Raises as `unmeasured_labels`."""
    if folder is None or not (folder / RECORDS).is_dir() or (labels := unmeasured_labels(site)) is None:
        return site
    path = record_file(labels, folder)
    fuel = site.fuel if path is None else site.fuel.model_copy(update={"label_errors": str(path)})
    return site.model_copy(update={"fuel": fuel})


def labels_state(site: Site) -> str:
    """Return what the labels that vote were measured on, for the map's information and exports; cameras with label
    heads of another state are named. Raises as `site_label_errors` and `camera_label_errors`."""
    states = dict.fromkeys(site.cameras, site_label_errors(site).state)
    states |= {name: errors.state for name, errors in camera_label_errors(site).items()}
    if len(found := set(states.values())) < 2:
        return next(iter(found), site_label_errors(site).state)
    return ", ".join(f"{name} {state}" for name, state in sorted(states.items()))


def site_segmenter(site: Site, camera: str, model: str = "", threads: int = 1) -> Segmenter:
    """Open the network of a site, or `model`, with the label head that the site file names for a camera.

    Raises ConfigError for a camera that the site lacks, and ModelError as `Segmenter.open`."""
    network = label_network(site, model or site.model)
    return Segmenter.open(network, threads, head=site.camera(camera).label_head, heads=site.label_heads)


def prompt_segmenter(site: Site, model: str, prompt: str, threads: int = 1) -> Segmenter:
    """Open the network of a site, or `model`, with a prompt as a class beside those of the site. Raises ConfigError,
    ModelError as `label_network`."""
    manifest = NetworkManifest.find(label_network(site, model or site.model, prompt))
    return Segmenter(manifest, threads, LabelSet.load(config_path(site.labels)))


def site_scene_filter(site: Site, camera: str) -> SceneFilter:
    """Return the scene filter of a camera. Raises ConfigError for an unknown camera or an invalid mask."""
    config = site.camera(camera)
    where, calibration = f"cameras.{camera}", config.calibration
    longitude, latitude = (float(np.radians(angle)) for angle in site.frame.to_lonlat(0.0, 0.0))
    place = longitude, latitude
    size = None if calibration is None else (calibration.width, calibration.height)
    if size is not None and size[0] * size[1] > site.limits.pixels:
        raise ConfigError(
            f"{where}.calibration: images of {size[0]} x {size[1]} pixels exceed `expert.limits.pixels`, "
            f"{site.limits.pixels}; correct the calibration, or raise the limit"
        )
    views = {view: MaskMaker(view.mask, f"{where}.view_masks.{view.name}") for view in config.view_masks or ()}
    make = None if config.mask is None else MaskMaker(config.mask, f"{where}.mask")
    return SceneFilter(make, size or (make.size if make else None), config.judge_pictures, views, place)
