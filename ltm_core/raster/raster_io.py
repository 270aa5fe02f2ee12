"""Open rasters of other programs for reading, and write GeoTIFF files."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import RasterError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.disk_io import is_file

_GDAL = {"GDAL_CACHEMAX": 32}
"""GDAL settings; the cache in MB replaces GDAL's default of a twentieth of the memory."""
MOST_CELLS = 1 << 30
"""Maximum number of cells of a raster that is read whole: 32 km per side at 1 m."""
_UNSUSPECTED = 16 << 20
"""Number of cells up to which a raster is not checked."""
MOST_BANDS = 100
"""Maximum number of bands; landscape files have ten. In a file interleaved by cell, one band cannot be read without the
others: with 4,097 bands, a block of 256 x 256 cells is a gigabyte."""
_GRIDS_OF_TEXT = ("AAIGrid", "GRASSASCIIGrid", "ISG")
_MOST_FOR_A_BYTE = 1000
"""Maximum number of cells per byte of the file; compressed elevations and codes need at least a tenth of a byte per
cell. A file may state any size without containing its tiles."""


@contextmanager
def open_raster(path: Path | str, driver: str | None = None) -> Iterator[Any]:
    """Open a raster of any kind for reading: the only function that does so. Read its bands with `read_band`.

    `driver`: the only format that is accepted, for files of unknown origin. Any GDAL error in the block becomes a
    RasterError that names the file; so does a file without a band (netCDF and HDF hold several rasters), and a mosaic
    of which a file is missing."""
    import rasterio
    from rasterio._err import CPLE_BaseError  # GDAL's errors, of which rasterio's own functions let some through
    from rasterio.errors import CRSError, RasterioError

    _check_is_data(Path(path))
    try:
        with rasterio.Env(**_GDAL), rasterio.open(path, driver=driver) as source:
            _check_bands(source, path)
            if source.driver in _GRIDS_OF_TEXT:
                _check_rows(source, path)
            yield source
    except (RasterioError, CPLE_BaseError, CRSError, UnicodeDecodeError) as error:  # the last: a CRS's name, no text
        raise RasterError(f"{path}: not a raster that GDAL can read ({error})") from error


def read_band(source: Any, band: int, window: Any = None) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return the stored values of a band (H, W), unscaled, and where they are unknown: nodata, mask or alpha.

    GDAL takes only one of these; a file that has a mask and a nodata value needs both."""
    from rasterio.enums import ColorInterp

    read = source.read(band, window=window, masked=True)
    values, unknown = read.data, np.ma.getmaskarray(read)
    nodata = source.nodatavals[band - 1]
    if nodata is not None and not np.isnan(nodata):
        unknown |= values == (values.dtype.type(nodata) if values.dtype.kind == "f" else nodata)
    for number in source.indexes:
        if source.colorinterp[number - 1] == ColorInterp.alpha and number != band:
            unknown |= source.read(number, window=window) == 0
    return values, unknown


def _check_bands(source: Any, path: Path | str) -> None:
    """Raise RasterError."""
    if source.count == 0:
        parts = [str(name) for name in source.subdatasets]
        raise RasterError(f"{path}: has no band of its own; give one of its parts: {', '.join(parts[:5]) or 'none'}")
    if source.count > MOST_BANDS:
        raise RasterError(
            f"{path}: has {source.count} bands, at most {MOST_BANDS} are supported; extract the one you need "
            "(gdal_translate -b)"
        )
    # A mosaic names files that may be absent; GDAL says so without a name, and only if it reads there.
    missing = [name for name in source.files if not name.startswith("/vsi") and not Path(name).exists()]
    if source.driver == "VRT" and missing:
        raise RasterError(
            f"{path}: {len(missing)} of its {len(source.files) - 1} files are missing, such as "
            f"{', '.join(missing[:3])}; copy them there, or make it again (gdalbuildvrt)"
        )
    for part in source.files[1:] if source.driver == "VRT" else ():
        if part.lower().endswith(".vrt"):
            with open_raster(part):
                pass


def _check_rows(source: Any, path: Path | str) -> None:
    """GDAL looks for a row of text by reading those before it, and where one is missing for each of them anew: of one
    that ends early the last row takes years. In order, the first that is missing ends it. Raises RasterError."""
    from rasterio.errors import RasterioError
    from rasterio.windows import Window

    size = Path(path).stat().st_size if is_file(Path(path)) else None
    if size is not None and 2 * source.width > size + 1:
        raise RasterError(f"{path}: states rows of {source.width} numbers in a file of {size} bytes; download it again")
    for row in range(source.height):
        try:
            source.read(1, window=Window(0, row, source.width, 1))
        except RasterioError as error:
            raise RasterError(
                f"{path}: row {row + 1} of {source.height} is missing or not numeric; download it again"
            ) from error


def _check_is_data(path: Path) -> None:
    """Some of GDAL's formats are a text that names a web service, whatever the file is called: of texts, VRT alone is
    followed. Raises RasterError."""
    try:
        with path.open("rb") as file:
            head = file.read(1024)
    except OSError:
        return  # a folder, or GDAL's name of a part of a file; what is not there GDAL says best
    if head.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"<", b"{") and b"<VRTDataset" not in head:
        raise RasterError(f"{path}: not a raster but a text file ({head[:40]!r}); give the raster itself")


def check_size(source: Any, path: Path | str, height: int, width: int) -> None:
    """Check the number of cells before a raster is read at once. Raises RasterError if it exceeds the limit, or what
    the file can contain."""
    cells = height * width
    if cells <= _UNSUSPECTED:
        return
    files = [Path(name) for name in source.files]
    size = sum(file.stat().st_size for file in files if is_file(file))
    # A VRT holds nothing itself, and names files that may be elsewhere.
    if cells > MOST_CELLS or (source.driver != "VRT" and cells > size * _MOST_FOR_A_BYTE):
        raise RasterError(
            f"{path}: states {width} x {height} cells in a file of {size} bytes; at most {MOST_CELLS} cells, "
            f"and {_MOST_FOR_A_BYTE} per byte, are read: clip it to the site (gdalwarp -te)"
        )


_BLOCK = 256
_CACHE_MB = 64
"""Cache size in MB; GDAL's default is a twentieth of the memory."""


def write_geotiff(
    path: Path | str,
    array: NDArray[np.generic],
    geometry: GridGeometry,
    nodata: float | None = None,
    colormap: Mapping[int, tuple[int, int, int]] | None = None,
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write an (H, W) or (bands, H, W) array as a tiled, deflated GeoTIFF.

    `colormap`: value -> RGB, for uint8 rasters. The bytes depend on the arguments alone. Raises RasterError where
    the geometry has no CRS or does not fit the array, OSError where the file cannot be written."""
    import rasterio
    from rasterio.io import MemoryFile
    from rasterio.windows import Window

    if geometry.crs is None:
        raise RasterError(f"{path}: a GeoTIFF needs a CRS, but this raster has none")
    bands = array if array.ndim == 3 else array[None]
    if bands.shape[1:] != geometry.shape:
        raise RasterError(f"{path}: array of {bands.shape[1:]} does not fit a raster of {geometry.shape}")
    height, width = geometry.shape
    options: dict[str, Any] = {"width": width, "height": height, "count": len(bands), "dtype": array.dtype}
    options |= {"driver": "GTiff", "crs": geometry.crs, "transform": geometry.transform(), "nodata": nodata}
    options |= {"tiled": True, "blockxsize": _BLOCK, "blockysize": _BLOCK, "compress": "deflate"}
    options["predictor"] = 3 if np.issubdtype(array.dtype, np.floating) else 2
    # GDAL keeps the errors of a disk that fills up while it writes to itself, and leaves half a file.
    with rasterio.Env(GDAL_CACHEMAX=_CACHE_MB), MemoryFile() as memory:
        with memory.open(**options) as sink:
            # Strip after strip, every band of it: a block that left the cache half written would be written twice.
            for row in range(0, height, _BLOCK):
                strip = bands[:, row : row + _BLOCK]
                sink.write(strip, window=Window(0, row, width, strip.shape[1]))
            if colormap is not None:
                sink.write_colormap(1, {value: (*rgb, 255) for value, rgb in colormap.items()})
            if tags:
                sink.update_tags(**tags)
        Path(path).write_bytes(memory.getbuffer())
