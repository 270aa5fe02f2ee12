"""Make the photos of ltm_lab/config/training/near_photos.yaml from the packages that hold them, unpacked.

    python tools/near_photos.py PACKAGES SKIES OUT

PACKAGES/NAME: what each package of that file's list holds, unpacked; SKIES: the folder of the mountain photos, whose
skies stand behind the panorama of a meadow. OUT gets NAME.jpg, three to two. Needs the extra `sim`, to read OpenEXR.
"""

import base64
import re
import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]

_PLASMA = "plasma-workspace-wallpapers/usr/share/wallpapers"
WALLPAPERS = {
    "lomiri_aitzgorri": "lomiri-wallpapers-16.04/usr/share/backgrounds/aitzgorri_by_Aitzol_Berasategi.jpg",
    "lomiri_picosdeeuropa": "lomiri-wallpapers-16.04/usr/share/backgrounds/picosdeeuropa_by_Aitzol_Berasategi.jpg",
    "lomiri_life": "lomiri-wallpapers-16.04/usr/share/backgrounds/life_by_Aitzol_Berasategi.jpg",
    "lomiri_sunset": "lomiri-wallpapers-16.04/usr/share/backgrounds/sunset_by_Aitzol_Berasategi.jpg",
    "mate_Dune": "mate-backgrounds/usr/share/backgrounds/mate/nature/Dune.jpg",
    "mate_Storm": "mate-backgrounds/usr/share/backgrounds/mate/nature/Storm.jpg",
    "mate_GreenMeadow": "mate-backgrounds/usr/share/backgrounds/mate/nature/GreenMeadow.jpg",
    "plasma_Path": f"{_PLASMA}/Path/contents/images/2560x1600.jpg",
    "plasma_OneStandsOut": f"{_PLASMA}/OneStandsOut/contents/images/2560x1600.jpg",
    "palapeli_castle": "palapeli-data/usr/share/palapeli/collection/castle-maintenon.jpg",
}
ACTIVITIES = {  # of gcompris-qt-data: resource file -> prefix of the names
    "explore_monuments": "gc_monument",
    "details": "gc_details",
    "explore_farm_animals": "gc_farm",
    "explore_world_animals": "gc_world",
}
PANORAMAS = ("park", "forest", "dawn", "sunrise", "sunset", "city", "venice")  # of @pmndrs/assets, package/hdri
PITCHES = (-4.0, -8.0, 0.0, -12.0, 2.0)
FIELD = 75.0  # degrees across
SKY_OF = ("22", "23", "38", "59", "118", "124", "146", "155", "180", "192", "211", "222")  # imageN_resized.jpg
MEADOW = (4, 5, 6, 7, 8, 1, 2, 3)  # the eight sides of Stellarium's landscape `guereins`, in order


def main() -> None:
    packages, skies, out = (Path(argument) for argument in sys.argv[1:4])
    out.mkdir(parents=True, exist_ok=True)
    for name, path in WALLPAPERS.items():
        write(out / f"{name}.jpg", read(packages / path))
    resources = packages / "gcompris-qt-data/usr/share/gcompris-qt/rcc"
    for activity, prefix in ACTIVITIES.items():
        for number, image in enumerate(webp_photos((resources / f"{activity}.rcc").read_bytes())):
            write(out / f"{prefix}_{number}.jpg", image)
    for number, image in enumerate(
        meadow(packages / "stellarium-data/usr/share/stellarium/landscapes/guereins", skies)
    ):
        write(out / f"guereins_{number:02d}.jpg", image)
    for name in PANORAMAS:
        for number, image in enumerate(views(packages / f"pmndrs-assets/package/hdri/{name}.exr.js")):
            write(out / f"hdri_{name}_{number}.jpg", image)


def read(path: Path) -> Image:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise SystemExit(f"{path}: cannot be read; unpack the package there")
    return np.asarray(image, np.uint8)


def write(path: Path, image: Image) -> None:
    """The middle of an image, three to two, at most 1200 pixels wide."""
    height, width = image.shape[:2]
    if width > height * 1.5:
        cut = int((width - height * 1.5) / 2)
        image = image[:, cut : width - cut]
    else:
        cut = int((height - width / 1.5) / 2)
        image = image[cut : height - cut]
    scale = min(1.0, 1200 / image.shape[1])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(path), small, [cv2.IMWRITE_JPEG_QUALITY, 92])


def webp_photos(data: bytes) -> list[Image]:
    """The WebP pictures of a resource file that are 380 pixels or more each way, in their order."""
    found = []
    for match in re.finditer(rb"RIFF(....)WEBP", data, re.DOTALL):
        size = int.from_bytes(match[1], "little")
        if size <= 15000:
            continue
        image = cv2.imdecode(np.frombuffer(data[match.start() : match.start() + 8 + size], np.uint8), cv2.IMREAD_COLOR)
        if image is not None and min(image.shape[:2]) >= 380:
            found.append(np.asarray(image, np.uint8))
    return found


def meadow(folder: Path, photos: Path) -> list[Image]:
    """Twenty views about a meadow, each under the sky of a mountain photo."""
    sides = [cv2.imread(str(folder / f"guereins{n}.png"), cv2.IMREAD_UNCHANGED) for n in MEADOW]
    strip = np.hstack(sides)
    skies = [read(photos / f"image{n}_resized.jpg") for n in SKY_OF]
    skies = [sky[: int(len(sky) * 0.12)] for sky in skies]
    height, width = strip.shape[:2]
    around, rng, result = np.hstack([strip, strip[:, : width // 3]]), np.random.default_rng(1), []
    for k in range(20):
        across = int(rng.uniform(560, 1100) * width / 4096)
        down, left = int(across / 1.5), int(width * k / 20)
        top = int(int(height * 0.39) - down * rng.uniform(0.35, 0.6))
        canvas = np.zeros((down, across, 4), np.uint8)
        first, part = max(0, -top), around[max(0, top) : min(height, top + down), left : left + across]
        canvas[first : first + len(part), : part.shape[1]] = part
        canvas = canvas[: first + len(part)]
        sky = cv2.resize(skies[k % len(skies)], canvas.shape[1::-1], interpolation=cv2.INTER_CUBIC)
        cover = canvas[..., 3:] / 255.0
        result.append((canvas[..., :3] * cover + sky * (1 - cover)).astype(np.uint8))
    return result


def views(path: Path) -> list[Image]:
    """Five views of a panorama, tone-mapped."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    code = re.search(r"base64,([^']+)'", path.read_text(encoding="ascii"))
    if code is None:
        raise SystemExit(f"{path}: holds no panorama")
    stream = mi.MemoryStream()
    stream.write(base64.b64decode(code[1]))
    stream.seek(0)
    bitmap = mi.Bitmap(stream, mi.Bitmap.FileFormat.OpenEXR)
    light = np.array(bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))[..., ::-1]
    light = np.clip(light, 0, None)
    height, width, result = light.shape[0], light.shape[1], []
    across, down = 480, 320
    focal = across / 2 / np.tan(np.radians(FIELD / 2))
    x, y = np.meshgrid(np.arange(across) - across / 2, np.arange(down) - down / 2)
    rays = np.stack([x, y, np.full_like(x, focal)], -1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    for k, degrees in enumerate(PITCHES):
        pitch = np.radians(degrees)
        below = rays[..., 1] * np.cos(pitch) - rays[..., 2] * np.sin(pitch)
        ahead = rays[..., 1] * np.sin(pitch) + rays[..., 2] * np.cos(pitch)
        column = (np.arctan2(rays[..., 0], ahead) + np.radians(72 * k)) / (2 * np.pi) % 1 * width
        row = (np.arcsin(np.clip(below, -1, 1)) / np.pi + 0.5) * height
        view = cv2.remap(
            light, column.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
        )
        level = max(float(np.percentile(view.mean(-1)[down // 3 :], 80)), 1e-4)
        view = view / level * 0.45
        result.append((np.clip(view / (1 + view * 0.25) * 1.2, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8))
    return result


if __name__ == "__main__":
    main()
