"""`ltm mask` and `ltm label`: mask foreground objects, and label areas in photos."""

from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from typer import Argument, Option

from ltm_core.base.errors import ConfigError
from ltm_core.label_heads.labelled_frames import evenly
from ltm_core.pictures import to_png
from ltm_core.pictures.photo_overlays import mask_picture
from ltm_core.site.site_io import load_site
from ltm_core.storage.config_io import checked
from ltm_core.storage.disk_io import require_files, require_folder
from ltm_core.storage.image_io import photos_in, read_rgb
from ltm_core.vision.areas import NamedArea, polygons_of, read_areas, write_areas
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_core.vision.mask_config import ViewMask
from ltm_core.vision.mask_proposals import MOST_FRAMES, drawn_proposals, propose_mask
from ltm_core.vision.masks import write_mask
from ltm_core.vision.segmenter import Segmenter
from ltm_ros.cli.output import Overwrite, numbers, print_table, say
from ltm_ros.labelling.server import LabelServer, LabelSession, serve
from ltm_ros.recordings.recorded_run import recorded_pictures


def label(
    folder: Annotated[Path, Argument(help="Folder of photos; receives polygons.json and NAME_labels.png.")],
    model: Annotated[str, Option(help="Network that proposes labels, or none. Default: the shipped one.")] = "",
    port: Annotated[int, Option(min=0, max=65535, help="Local TCP port; 0: a free one.")] = 0,
    browser: Annotated[bool, Option(help="Open the page in a browser.")] = True,
) -> None:
    """Label areas in photos with polygons and a brush, on a web page that only this machine can open.

    A photo is saved when you leave it, or with Ctrl-S. Ctrl-C ends the program."""
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder")
    require_folder(folder)
    session = LabelSession(folder, None if model == "none" else Segmenter.open(model or DEFAULT_MODEL))
    serve(partial(LabelServer, session), port, browser)


def mask(
    pictures: Annotated[Path, Argument(help="Folder of one camera's images, or a recording (with --site).")],
    out: Annotated[Path | None, Option("--out", "-o", help="PNG to write. Default: CAMERA_mask.png at SITE.")] = None,
    site: Annotated[Path | None, Option(help="Site file of the camera.")] = None,
    camera: Annotated[str, Option(help="Name of the camera in the site file.")] = "",
    only: Annotated[str, Option(metavar="PATTERN", help="Pattern of image names in a folder, as 'west_2018*'.")] = "*",
    keep: Annotated[str, Option(help="Numbers of the correct proposals, such as 1,3; or all, or none.")] = "",
    drawn: Annotated[Path | None, Option(help="polygons.json of `ltm label`: also propose its masked areas.")] = None,
    view: Annotated[str, Option(help="PTZ camera: name of the view of these images (with --looking).")] = "",
    looking: Annotated[
        str, Option(help="Its direction: AZIMUTH,PITCH[,HFOV] in degrees; others of a recording are ignored.")
    ] = "",
    overwrite: Overwrite = False,
) -> None:
    """Propose a camera's mask: bars, frames, lens corners, captions. Check the written image, then repeat with --keep.

    Without --keep, the PNG and the polygons hold every proposal. With --keep, they hold only the chosen ones, and the
    line for the site file is printed. The proposals depend only on the images, so their numbers stay the same. Draw
    masts, roofs and other objects on the labelling page (`ltm label`), and pass them with --drawn."""
    if (site is None) != (not camera):
        raise ConfigError("give --site and --camera together: the site file and the camera of the mask")
    turned = _view(view, looking)
    known = None if site is None else load_site(site)
    if known is not None:
        known.camera(camera)
    is_recording = pictures.is_file() or any(pictures.glob("*.mcap"))
    if is_recording and known is None:
        raise ConfigError(f"{pictures} is a recording: give --site and --camera to choose its images")
    target = out or (
        site.parent / f"{camera}{f'_{view}' if view else ''}_mask.png" if site is not None else Path("mask.png")
    )
    beside = target.with_suffix(".json"), target.with_name(f"{target.stem}_proposals.png")
    require_files([target, *beside], overwrite or bool(keep))
    if is_recording and known is not None:
        names, frames = recorded_pictures(pictures, known, camera, MOST_FRAMES, turned)
    else:
        photos = evenly(photos_in(pictures, only), MOST_FRAMES)
        names, frames = [photo.name for photo in photos], [read_rgb(photo) for photo in photos]
    proposals = propose_mask(frames)
    if drawn is not None:
        areas = [area for area in read_areas(drawn) if area.image in names]
        proposals += drawn_proposals(areas, LabelSet.load().names, frames[0].shape[:2])
    kept = _kept(keep, len(proposals))
    numbered = list(zip(range(1, len(proposals) + 1), proposals, kept, strict=True))
    rows = ((str(n), p.kind, f"{p.hidden.mean():.2%}", p.reason, "yes" if keeps else "no") for n, p, keeps in numbered)
    print_table(f"{len(frames)} images of one camera", (">number", "what", ">share", "why", "kept"), rows)
    target.parent.mkdir(parents=True, exist_ok=True)
    beside[1].write_bytes(to_png(mask_picture(frames[0], [p.hidden for p in proposals], kept)))
    say(f"check {beside[1]}")
    chosen = [(n, p) for n, p, keeps in numbered if keeps]
    if not chosen:
        say("nothing to mask" if keep or not proposals else "nothing is kept")
        return
    hidden = np.logical_or.reduce([proposal.hidden for _, proposal in chosen])
    write_mask(target, hidden)
    areas = [
        NamedArea(image=names[0], kind=proposal.kind, polygon=polygon, number=number, reason=proposal.reason)
        for number, proposal in chosen
        for polygon in polygons_of(proposal.hidden)
    ]
    write_areas(beside[0], areas)
    say(f"{target}: {hidden.mean():.1%} of the image\n  {beside[0]}")
    if keep:
        typer.echo(f"cameras:\n  {camera or 'CAMERA'}:\n{_line(_below(target, site), turned)}")
    else:
        typer.echo("confirm with --keep, such as --keep " + ",".join(str(n) for n, _ in chosen))


def _view(name: str, looking: str) -> ViewMask | None:
    """Return the view of --view and --looking, without its mask. Raises ConfigError."""
    if bool(name) != bool(looking):
        raise ConfigError("give --view and --looking together: the name and the viewing direction of a view")
    if not name:
        return None
    parts = numbers(looking, "--looking AZIMUTH,PITCH[,HFOV]", (2, 3))
    stated = dict(zip(("azimuth_deg", "pitch_deg", "hfov_deg"), parts, strict=False))
    return checked(ViewMask, {"name": name, **stated, "mask": "-"}, f"--looking {looking}")


def _line(mask: str, view: ViewMask | None) -> str:
    """Return the lines for the site file, below the camera."""
    if view is None:
        return f"    mask: {mask}"
    stated = view.model_dump(exclude={"mask"}, exclude_defaults=True) | {"mask": mask}
    return "    view_masks:\n      - {" + ", ".join(f"{key}: {value}" for key, value in stated.items()) + "}"


def _kept(keep: str, count: int) -> list[bool]:
    if keep in ("", "all", "none"):
        return [keep != "none"] * count
    try:
        numbers = {int(part) for part in keep.split(",")}
    except ValueError as error:
        raise ConfigError(f"--keep {keep}: expected numbers of proposals such as 1,3, or all, or none") from error
    unknown = sorted(numbers - set(range(1, count + 1)))
    if unknown:
        raise ConfigError(f"--keep {keep}: there is no proposal {unknown[0]}; there are {count}")
    return [number in numbers for number in range(1, count + 1)]


def _below(target: Path, site: Path | None) -> str:
    """Return the mask's path for the site file."""
    folder = target.parent if site is None else site.parent
    resolved = target.resolve()
    if resolved.is_relative_to(folder.resolve()):
        return resolved.relative_to(folder.resolve()).as_posix()
    return f"{target.name}   # copy {target} into {folder}: a site file names only files in its folder"
