"""Scans of two axes: motions with their tables of lines, pixels and triggers; images, samples, files of images."""

from truestroke.signals.scans.image_files import read_images, save_images
from truestroke.signals.scans.images import (
    Distortion,
    Image,
    ImageError,
    at_pixels,
    distortion,
    gridded,
    images,
    pixels_of,
    shift,
)
from truestroke.signals.scans.motions import cycloid, lissajous, raster, spiral
from truestroke.signals.scans.rates import quiet_rate
from truestroke.signals.scans.recorded import Recorded, recorded
from truestroke.signals.scans.samples import Grating, Texture
from truestroke.signals.scans.scan import LINE, TRIGGER, Scan

__all__ = [
    "LINE",
    "TRIGGER",
    "Distortion",
    "Grating",
    "Image",
    "ImageError",
    "Recorded",
    "Scan",
    "Texture",
    "at_pixels",
    "cycloid",
    "distortion",
    "gridded",
    "images",
    "lissajous",
    "pixels_of",
    "quiet_rate",
    "raster",
    "read_images",
    "recorded",
    "save_images",
    "shift",
    "spiral",
]
