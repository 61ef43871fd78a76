"""Files of images: Gwyddion's .gsf and .gwy, NeXus in the layout of NXspm, TIFF with its resolution (extra `scan`).

All of them show the highest y first, as a picture does; an `Image` has the lowest first.
"""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from truestroke.base import checks, files, hdf5
from truestroke.base.checks import SettingError
from truestroke.base.files import Kind
from truestroke.base.typing import FloatArray
from truestroke.signals.scans.images import Image, ImageError
from truestroke.signals.scans.scan import Scan

LENGTHS = {"pm": 1e-6, "nm": 1e-3, "um": 1.0, "micron": 1.0, "microns": 1.0, "mm": 1e3, "cm": 1e4, "m": 1e6}  # in um
MICRO = {"\u00b5": "u", "\u03bc": "u", "\\u00B5": "u"}  # the sign, the Greek letter, and what ImageJ writes of it
COLOURS = {2, 3, 4}  # numbers a pixel: grey, or red, green and blue, the even ones with opacity
MAKER = "truestroke"
UNEVEN = 0.5  # of a pixel: how far one may be from where even pixels would be
PIXEL = "pixel_size"  # attribute of an axis of NeXus, of one pixel too, whose centre does not say how wide it is
CHANNEL = re.compile("/[0-9]+/data")  # of a .gwy
ENDINGS = {".gsf": "gsffile", ".gwy": "gwyfile", ".tif": "tifffile", ".tiff": "tifffile", ".nxs": "h5py"}
"""Endings of the files, and the package that writes and reads each."""


def _by_us(path: Path) -> bool:
    with path.open("rb") as file:
        return MAKER.encode() in file.read()


IMAGE = Kind("an image", _by_us)


def save_images(
    path: str | Path, images: Image | Mapping[str, Image] | Sequence[Image], *, scan: Scan | None = None
) -> Path:
    """Write images of one scan into a file; its ending is the format.

    ======  =========================================================  ===============
    .gsf    Gwyddion Simple Field, one image, float32                  gsffile
    .gwy    Gwyddion, all images as channels                           gwyfile
    .tif    TIFF, float32, a page for each image, with its resolution  tifffile
    .nxs    NeXus (HDF5) in the layout of NXspm: each image as NXdata  h5py
            with axes in um; region, pattern and calibration of the
            scan, where it is given
    ======  =========================================================  ===============

    Heights are written in m where the format has units of its own (.gsf, .gwy). A name in a .gsf has : in place of =,
    and spaces in place of line breaks.

    Parameters
    ----------
    path : str or Path
        Where to.
    images : Image, sequence or mapping of them
        All of one area; a .gsf takes one.
    scan : Scan, optional
        What they were made of, for .nxs.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    SettingError
        The ending is none of these, or the number of images does not fit it.
    ImageError
        The package for it is missing.
    FileExistsError
        A file is there that truestroke did not write.

    Examples
    --------
    >>> import tempfile
    >>> made = Image(data=np.eye(3), size=(2.0, 1.0), name="trace", unit="nm")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     back = read_images(save_images(Path(folder, "trace.gsf"), made))
    >>> back[0].size, back[0].data[0].round(3).tolist(), back[0].unit
    ((2.0, 1.0), [1.0, 0.0, 0.0], 'nm')
    """
    path = checks.path("path", path)
    several = (
        [images] if isinstance(images, Image) else list(images.values() if isinstance(images, Mapping) else images)
    )
    for image in several:
        checks.instance("images", image, Image, "an Image, such as of truestroke.scans.images(scan, signal)")
    if not several:
        raise SettingError("images", "none", "at least one")
    require_library(path)
    write = WRITERS[path.suffix.lower()]
    with files.writing(path, IMAGE) as draft:
        write(draft, several, scan)
    return path


def read_images(path: str | Path) -> list[Image]:
    """The images in a .gsf, .gwy, .tif or .nxs file; heights come in nm, places in um.

    Raises
    ------
    ImageError
        The file holds no image, or is damaged.
    SettingError
        The ending is none of these.
    FileNotFoundError
        There is no such file.
    """
    path = files.existing(checks.path("path", path))
    if path.suffix.lower() not in ENDINGS:
        remedy = "save it as one of these where it was recorded, or in Gwyddion; a picture such as .png has no heights"
        raise SettingError("path", str(path), f"a file that ends with {', '.join(ENDINGS)}: {remedy}")
    require_library(path)
    read = READERS[path.suffix.lower()]
    try:
        made = read(path)
    except (KeyError, ValueError, IndexError, TypeError, OSError, AssertionError) as error:
        reason = " ".join(str(error).split())[:200] or "it does not begin as one"
        raise ImageError(
            f"{path}: the file is damaged, or no image ({reason}): copy it again, or export it where it was recorded"
        ) from error
    if not made:
        raise ImageError(f"{path}: there is no image in it")
    return made


def require_library(path: Path, argument: str = "path") -> None:
    """An error where the package for the ending of what the argument names is missing, or there is none."""
    module = ENDINGS.get(path.suffix.lower())
    if module is None:
        raise SettingError(argument, str(path), f"a file that ends with {', '.join(ENDINGS)}")
    if module == "gsffile" and path.suffix != ".gsf":
        raise SettingError(argument, str(path), "a file that ends with .gsf, in small letters, as gsffile asks for")
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        text = f'{path}: files of this kind need the package {module}: pip install "truestroke[scan]"'
        raise ImageError(text) from error


def _in_m(image: Image) -> tuple[FloatArray, str]:
    """Data, highest y first, and unit; a height in m."""
    um = LENGTHS.get(_plain(image.unit))
    return image.data[::-1] * (1e-6 * um if um else 1.0), "m" if um else image.unit


def _as_read(data: Any, unit: str, size: Sequence[float], origin: Sequence[float], name: str, um: float) -> Image:
    """Of data with the highest y first and places in units of so many um; a height in m becomes nm."""
    values = np.asarray(data, dtype=np.float64)[::-1] * (1e9 if unit == "m" else 1.0)
    width, height, x, y = (float(f"{um * float(one):.9g}") for one in (*size, *origin))
    return Image(data=values, size=(width, height), origin=(x, y), name=name, unit="nm" if unit == "m" else unit)


def _um(unit: str) -> float:
    """The unit of a place, um."""
    plain = _plain(unit)
    if plain not in LENGTHS:
        raise ValueError(f"places in {plain!r}, which must be one of {', '.join(LENGTHS)}")
    return LENGTHS[plain]


def _plain(unit: str) -> str:
    for sign, letter in MICRO.items():
        unit = unit.replace(sign, letter)
    return unit.strip()


# ---- Gwyddion ------------------------------------------------------------------------------------------------------


def _write_gsf(path: Path, images: Sequence[Image], _: Scan | None) -> None:
    import gsffile

    if len(images) != 1:
        raise SettingError("images", f"{len(images)} images", "one: a .gsf holds one; take .gwy, .tif or .nxs")
    image, (data, unit) = images[0], _in_m(images[0])
    about: dict[str, object] = {"XReal": 1e-6 * image.size[0], "YReal": 1e-6 * image.size[1]}
    about |= {"XOffset": 1e-6 * image.origin[0]}
    about |= {"YOffset": 1e-6 * image.origin[1], "XYUnits": "m", "ZUnits": unit, "Software": MAKER}
    about |= {"Title": " ".join(image.name.replace("=", ":").splitlines())}
    gsffile.write_gsf(path, np.ascontiguousarray(data, np.float32), about)


def _read_gsf(path: Path) -> list[Image]:
    import gsffile

    data, about = gsffile.read_gsf(path)
    size = [about.get("XReal", 1e-6 * data.shape[1]), about.get("YReal", 1e-6 * data.shape[0])]
    origin = [about.get("XOffset", 0.0), about.get("YOffset", 0.0)]
    um, title = _um(str(about.get("XYUnits") or "m")), str(about.get("Title", path.stem))
    return [_as_read(data, str(about.get("ZUnits", "")), size, origin, title, um)]


def _write_gwy(path: Path, images: Sequence[Image], _: Scan | None) -> None:
    from gwyfile.objects import GwyContainer, GwyDataField, GwySIUnit

    made = GwyContainer()
    for i, image in enumerate(images):
        data, unit = _in_m(image)
        made[f"/{i}/data/title"] = image.name
        made[f"/{i}/data"] = GwyDataField(
            np.ascontiguousarray(data),
            xreal=1e-6 * image.size[0],
            yreal=1e-6 * image.size[1],
            xoff=1e-6 * image.origin[0],
            yoff=1e-6 * image.origin[1],
            si_unit_xy=GwySIUnit(unitstr="m"),
            si_unit_z=GwySIUnit(unitstr=unit),
        )
        made[f"/{i}/meta"] = GwyContainer({"Software": MAKER})
    made.tofile(str(path))


def _read_gwy(path: Path) -> list[Image]:
    import gwyfile

    found = gwyfile.load(str(path))
    made = []
    for key in sorted((key for key in found if CHANNEL.fullmatch(key)), key=lambda key: int(key.split("/")[1])):
        f, title = found[key], found.get(f"{key}/title", path.stem)
        name = chr(title) if isinstance(title, int) else str(title)  # gwyfile writes a single letter as a number
        origin, um = (f.get("xoff", 0.0), f.get("yoff", 0.0)), _um(f.si_unit_xy.unitstr or "m")
        made.append(_as_read(f.data, f.si_unit_z.unitstr, (f.xreal, f.yreal), origin, name, um))
    return made


# ---- TIFF ----------------------------------------------------------------------------------------------------------


def _write_tiff(path: Path, images: Sequence[Image], _: Scan | None) -> None:
    import tifffile

    with tifffile.TiffWriter(path) as file:
        for image in images:
            about = {"name": image.name, "unit": image.unit, "origin_um": image.origin, "size_um": image.size}
            file.write(
                np.ascontiguousarray(image.data[::-1], np.float32),
                photometric="minisblack",
                resolution=tuple(1e4 / pixel for pixel in image.pixel),
                resolutionunit="CENTIMETER",
                software=MAKER,
                description=json.dumps(about),
                metadata=None,
                contiguous=False,
            )


def _read_tiff(path: Path) -> list[Image]:
    import tifffile

    made = []
    with tifffile.TiffFile(path) as file:
        shared = _by_imagej(file) or _by_ome(file)
        for i, page in enumerate(file.pages):
            data = _grey(_measured(page))
            tags = {tag.name: tag.value for tag in page.tags}
            about = _about(str(tags.get("ImageDescription", "")))
            names, size = shared.get("names", ()), _size(data.shape, tags, shared.get("unit"))
            if pixel := shared.get("pixel"):
                size = pixel[0] * data.shape[1], pixel[1] * data.shape[0]
            made.append(
                Image(
                    data=data[::-1],
                    size=tuple(about.get("size_um") or size),
                    origin=tuple(about.get("origin_um") or (0.0, 0.0)),
                    name=str(about.get("name") or (names[i] if i < len(names) else path.stem)),
                    unit=str(about.get("unit", "")),
                )
            )
    return made


def _measured(page: Any) -> FloatArray:
    """The numbers of a page of a TIFF: brighter is more, and those of a palette are its colours."""
    data = np.asarray(page.asarray())
    if np.iscomplexobj(data):
        raise ValueError("complex numbers: export their size or their phase")
    if page.photometric is not None and page.photometric.name == "MINISWHITE":
        white = 2.0**page.bitspersample - 1 if data.dtype.kind in "bu" else 0.0
        return np.asarray(white - data.astype(np.float64))
    if page.colormap is not None:
        data = np.moveaxis(page.colormap[:, data], 0, -1)
    return np.asarray(data, dtype=np.float64)


def _by_imagej(file: Any) -> dict[str, Any]:
    """The unit of the resolution, um, and the names of the pages, where ImageJ has written them."""
    found = file.imagej_metadata or {}
    unit = str(found.get("unit", "")).strip()
    known = {"unit": _um(unit)} if unit not in ("", "pixel", "pixels", "inch") else {}
    return known | ({"names": list(map(str, found["Labels"]))} if "Labels" in found else {})


def _by_ome(file: Any) -> dict[str, Any]:
    """Width and height of a pixel, um, and the names of the channels, where OME has written them."""
    if not file.ome_metadata:
        return {}
    import tifffile

    image = tifffile.xml2dict(file.ome_metadata)["OME"]["Image"]
    pixels = (image[0] if isinstance(image, list) else image)["Pixels"]
    channels = pixels.get("Channel", [])
    every = channels if isinstance(channels, list) else [channels]
    found: dict[str, Any] = {"names": [str(one["Name"]) for one in every if "Name" in one]}
    if {"PhysicalSizeX", "PhysicalSizeY"} <= pixels.keys():
        found["pixel"] = [
            float(pixels[f"PhysicalSize{axis}"]) * _um(str(pixels.get(f"PhysicalSize{axis}Unit", "um")))
            for axis in "XY"
        ]
    return found


def _grey(data: FloatArray) -> FloatArray:
    """A picture whose colours are alike is what was measured; of any other nobody knows what its colours mean."""
    if data.ndim < 3 or data.shape[-1] not in COLOURS:  # rows, columns, colours
        return data
    grey = data[..., : data.shape[-1] - 1 + data.shape[-1] % 2]  # without opacity
    if (grey != grey[..., :1]).any():
        raise ValueError(f"a picture in colour, {data.shape[-1]} numbers a pixel: export the signal itself, in grey")
    return np.asarray(grey[..., 0])


def _about(text: str) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except json.JSONDecodeError:
        return {}
    return found if isinstance(found, dict) else {}


def _size(shape: Sequence[int], tags: Mapping[str, Any], um: float | None) -> tuple[float, float]:
    """Width and height, um, by the resolution of a page, in pixels by unit; a pixel of 1 um where it has none."""
    unit = um or {2: 25_400.0, 3: 10_000.0}.get(int(tags.get("ResolutionUnit", 1)), 0.0)  # an inch, a centimetre
    known = [tags.get(name, (0, 1)) for name in ("XResolution", "YResolution")]
    if not unit or not all(one > 0 for pair in known for one in pair):
        return float(shape[1]), float(shape[0])
    across, down = (pixels / units / unit for pixels, units in known)
    return shape[1] / across, shape[0] / down


# ---- NeXus ---------------------------------------------------------------------------------------------------------


def _write_nexus(path: Path, images: Sequence[Image], scan: Scan | None) -> None:
    with hdf5.written(path) as file:
        digits = len(str(len(images) - 1))  # so that their order is that of the images
        names = [f"image_{i:0{digits}d}" for i in range(len(images))]
        entry = _group(file, "entry", "NXentry", default=names[0])
        file.attrs["default"] = "entry"
        entry["definition"] = "NXspm"
        entry["experiment_technique"] = "AFM"
        entry["program_name"] = MAKER
        for name, image in zip(names, images, strict=True):
            _nexus_data(entry, name, image)
        instrument = _group(entry, "experiment_instrument", "NXinstrument")
        control = _group(_group(instrument, "scan_environment", "NXenvironment"), "scan_control", "NXspm_scan_control")
        _nexus_scan(control, images[0], scan)
        if scan is not None:
            sensor = _group(instrument, "piezo_sensor", "NXspm_piezo_sensor")
            config = _group(sensor, "piezo_configuration", "NXspm_piezo_config")
            calibration = _group(config, "calibration", "NXcalibration")
            calibration["calibration_type"] = "active"
            for axis, motion in zip("xy", scan.axes, strict=True):
                _number(calibration, f"range_{axis}", motion.peak_to_peak, "um")


def _nexus_data(entry: Any, name: str, image: Image) -> None:
    data = _group(entry, name, "NXdata", signal="data", axes=["y", "x"], title=image.name)
    data["title"] = image.name
    _number(data, "data", image.data[::-1], image.unit)
    data["data"].attrs["interpretation"] = "image"
    for axis, start, size, pixels in zip("xy", image.origin, image.size, image.data.shape[::-1], strict=True):
        centres = start + (np.arange(pixels) + 0.5) * size / pixels
        _number(data, axis, centres if axis == "x" else centres[::-1], "um")
        data[axis].attrs[PIXEL] = size / pixels


def _nexus_scan(control: Any, image: Image, scan: Scan | None) -> None:
    region = _group(control, "scan_region", "NXspm_scan_region")
    pattern = _group(control, "mesh_SCAN", "NXspm_scan_pattern")
    for axis, start, size, pixels in zip("xy", image.origin, image.size, image.data.shape[::-1], strict=True):
        _number(region, f"scan_offset_value_{axis}", start + size / 2, "um")
        _number(region, f"scan_range_{axis}", size, "um")
        _number(region, f"scan_start_{axis}", start, "um")
        _number(region, f"scan_end_{axis}", start + size, "um")
        pattern[f"scan_points_{axis}"] = pixels
        _number(pattern, f"step_size_{axis}", size / pixels, "um")
    if scan is not None:
        control["scan_name"] = scan.name
        control["scan_type"] = "spiral" if scan.name == "spiral" else "mesh" if scan.name == "raster" else "trajectory"
        line = scan.lines[0]
        if scan.name == "raster":
            _number(pattern, "scan_speed_x", scan.size[0] / float(line["end"] - line["start"]), "um/s")


def _group(parent: Any, name: str, kind: str, **attributes: Any) -> Any:
    made = parent.create_group(name)
    made.attrs["NX_class"] = kind
    for key, value in attributes.items():
        made.attrs[key] = value
    return made


def _number(group: Any, name: str, value: Any, unit: str) -> None:
    group[name] = value
    group[name].attrs["units"] = unit


def _read_nexus(path: Path) -> list[Image]:
    import h5py

    made = []
    with h5py.File(path) as file:
        for entry in (one for one in file.values() if _words(one, "NX_class") == ["NXentry"]):
            for group in (one for one in entry.values() if _words(one, "NX_class") == ["NXdata"]):
                made += _nexus_images(group)
    return made


def _nexus_images(group: Any) -> list[Image]:
    """Signal and auxiliary signals of an NXdata, over the same axes."""
    axes = [group[name] for name in _words(group, "axes")]
    (signal,) = _words(group, "signal")
    if not len(axes) == group[signal].ndim == 2:
        raise ValueError(f"{group.name} has {len(axes)} axes for a signal of {group[signal].ndim}: an image has 2")
    places = [_centres(axis, pixels) for axis, pixels in zip(axes, group[signal].shape, strict=True)]
    (low, height), (west, width) = (_span(*one) for one in places)
    up, left = (one[0] > one[-1] for one, _ in places)
    title = str(group["title"].asstr()[()] if "title" in group else group.name)
    others = _words(group, "auxiliary_signals")
    made = []
    for name in (signal, *others):
        data = np.asarray(group[name], dtype=np.float64)[:: -1 if up else 1]
        unit = _unit(group[name])
        image = Image(
            data=data[..., :: -1 if left else 1] * (1e9 if unit == "m" else 1.0),
            size=(width, height),
            origin=(west, low),
            name=f"{title}, {name}" if others else title,
            unit="nm" if unit == "m" else unit,
        )
        made.append(image)
    return made


def _words(place: Any, name: str) -> list[str]:
    """The text of an attribute, or its texts; those of many writers are bytes."""
    texts = np.atleast_1d(place.attrs.get(name, ())).tolist()
    return [one.decode() if isinstance(one, bytes) else str(one) for one in texts]


def _unit(dataset: Any) -> str:
    return next(iter(_words(dataset, "units")), "")


def _centres(axis: Any, pixels: int) -> tuple[FloatArray, float]:
    """Places of an axis, um, of as many pixels, and the width of one; NeXus permits their edges, one more."""
    um = _um(_unit(axis) or "um")
    places = np.atleast_1d(np.asarray(axis, dtype=np.float64)) * um
    if places.size == pixels + 1:
        places = (places[1:] + places[:-1]) / 2
    if places.size != pixels:
        raise ValueError(f"the axis {axis.name} has {places.size} places for {pixels} pixels")
    if pixels == 1:
        return places, um * float(axis.attrs.get(PIXEL, 1.0))
    even = np.linspace(places[0], places[-1], pixels)
    pixel = abs(float(even[1] - even[0]))
    if not np.abs(places - even).max() <= UNEVEN * pixel:
        raise ValueError(f"the places of the axis {axis.name} are not even")
    return places, pixel


def _span(centres: FloatArray, pixel: float) -> tuple[float, float]:
    """Lower edge and length of pixels by their centres."""
    return float(f"{centres.min() - pixel / 2:.9g}"), float(f"{pixel * centres.size:.9g}")


WRITERS: dict[str, Callable[[Path, Sequence[Image], Scan | None], None]] = {
    ".gsf": _write_gsf,
    ".gwy": _write_gwy,
    ".tif": _write_tiff,
    ".tiff": _write_tiff,
    ".nxs": _write_nexus,
}
READERS: dict[str, Callable[[Path], list[Image]]] = {
    ".gsf": _read_gsf,
    ".gwy": _read_gwy,
    ".tif": _read_tiff,
    ".tiff": _read_tiff,
    ".nxs": _read_nexus,
}
