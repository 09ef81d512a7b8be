"""Image layers, and the files that hold them: multilayer OpenEXR in and out, PNG previews out.

Layers are named as Blender names render passes, and a channel is ``<ViewLayer>.<Pass>.<letter>``
(design.md, section 3).  The first row of an array and of a file is the top of the picture.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from .errors import SceneError

# The layers of every render, in the order of the file (design.md, section 3).
CONTRACT = (
    "Combined",
    "Direct",
    "Indirect",
    "DiffuseIndirect",
    "GlossyIndirect",
    "Irradiance",
    "Albedo",
    "Emission",
    "Normal",
    "Position",
    "Depth",
)
# Of each light group `<layer>_<group>`.
GROUP_LAYERS = ("Combined", "Direct", "Indirect")
# Layers of light, which an exposure makes brighter.
_LIGHT = {"Combined", "Direct", "Indirect", "DiffuseIndirect", "GlossyIndirect", "Irradiance", "Emission"}
# Layers that are vectors in space, not colours.
VECTORS = {"Normal", "Position"}
_LETTERS = {1: "V", 2: "XY", 3: "RGB", 4: "RGBA"}
# One-channel passes are called V (a value) or Z (a depth) by Blender's versions, Y by other programs.
_ORDER = {letter: i for i, letter in enumerate("RXVGYBZWA")}
# Blender knows a multilayer file by this attribute.
_BLENDER_MARK = ("BlenderMultiChannel", "Blender V2.55.1 and newer")
_PREFIX = "lumigate:"


@dataclass
class Layers(MutableMapping):
    """Layers of one picture by name, in order: (H, W, C) float32 each, C = 1 (a value) to 4.

    view_layer: Blender's view layer.  offset: (x, y) of the arrays' first pixel in the full frame, x to the
    right, y down; full_size: (width, height) of the full frame, None where the arrays are all of it.
    metadata: strings that go into the file's header.
    """

    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    view_layer: str = "ViewLayer"
    offset: tuple[int, int] = (0, 0)
    full_size: tuple[int, int] | None = None
    metadata: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        given, self.arrays = self.arrays, {}
        self.update(given)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.arrays[name]

    def __setitem__(self, name: str, array: np.ndarray) -> None:
        array = np.asarray(array, np.float32)
        if array.ndim == 2:
            array = array[..., None]
        if array.ndim != 3 or array.shape[2] not in _LETTERS:
            raise ValueError(f"layer {name!r} has the shape {array.shape}; wanted (height, width, 1 to 4 channels)")
        others = next((a for n, a in self.arrays.items() if n != name), array)
        if array.shape[:2] != others.shape[:2]:
            raise ValueError(f"layer {name!r} is {array.shape[1]}x{array.shape[0]}, the others {others.shape[1]}x{others.shape[0]} pixels")
        self.arrays[name] = array

    def __delitem__(self, name: str) -> None:
        del self.arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.arrays)

    def __len__(self) -> int:
        return len(self.arrays)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the arrays in pixels; (0, 0) where there are none."""
        return next(((a.shape[1], a.shape[0]) for a in self.arrays.values()), (0, 0))


def exposed(layers: Layers, exposure: float) -> Layers:
    """The same layers, those of light (of light groups, too) `exposure` times as bright; an alpha stays."""
    if exposure == 1:
        return layers
    bright = {name: array.copy() for name, array in layers.items()}
    for name, array in bright.items():
        if name in _LIGHT or name.startswith(tuple(f"{kind}_" for kind in GROUP_LAYERS)):
            array[..., :3] *= np.float32(exposure)
    return replace(layers, arrays=bright)


def channel_names(name: str, channels: int, view_layer: str) -> list[str]:
    """Names in the file of a layer's channels: ['ViewLayer.Normal.X', ...]."""
    letters = "XYZ" if name in VECTORS and channels == 3 else _LETTERS[channels]
    return [f"{view_layer}.{name}.{letter}" for letter in letters]


def write_whole(path: str | os.PathLike, write: Callable[[Path], None]) -> Path:
    """Let `write(temporary)` make a file beside `path`, then rename it: the file appears whole or not at all.

    Raises:
        SceneError: it could not be written (disk full, read-only folder), in one line.
    """
    path = Path(path)
    # The suffix stays last, for writers choose the format by it; a name of any length leaves room for the rest.
    temporary = path.with_name(f".{path.stem[:40]}.{zlib.crc32(path.name.encode()):08x}.{os.getpid()}.part{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        os.replace(temporary, path)
    except OSError as error:
        reason = " ".join((error.strerror or str(error)).split())
        raise SceneError(f"cannot write {path}: {reason}; choose another folder or free space on its disk") from error
    finally:
        if os.path.lexists(temporary):
            os.remove(temporary)
    return path


def _write_image(path: Path, spec: oiio.ImageSpec, pixels: np.ndarray) -> None:
    output = oiio.ImageOutput.create(str(path))
    if output is None:
        raise OSError(oiio.geterror() or f"no writer for {path.suffix} files")
    if not output.open(str(path), spec):
        raise OSError(output.geterror() or "cannot create the file")
    written = output.write_image(np.ascontiguousarray(pixels))
    error = output.geterror()
    if not output.close() or not written or error:
        raise OSError(error or output.geterror() or "the data could not be written")
    _check_end(path)


def _check_end(path: Path) -> None:
    """The last row can be read: a disk that fills up while the writer flushes its buffer is no error to it."""
    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise OSError(_reason(oiio) or "the file is not whole")
    spec = image.spec()
    last = spec.y + spec.height - 1
    row = image.read_scanlines(0, 0, last, last + 1, 0, 0, 1, oiio.FLOAT)
    image.close()
    if row is None:
        raise OSError(_reason(image) or "the file is not whole")


def write_exr(path: str | os.PathLike, layers: Layers) -> Path:
    """Write `layers` as one-part multilayer OpenEXR, float32, lossless ZIP in blocks of 16 rows.

    Blender's Image node and file loader, and oiiotool, read it.  The file appears whole or not at all.

    Raises:
        SceneError: the file cannot be written.
    """
    if not layers:
        raise ValueError("no layers to write")
    width, height = layers.size
    names = [n for name, a in layers.items() for n in channel_names(name, a.shape[2], layers.view_layer)]
    spec = oiio.ImageSpec(width, height, len(names), oiio.FLOAT)
    spec.channelnames = names
    spec.x, spec.y = layers.offset
    spec.full_width, spec.full_height = layers.full_size or (width, height)
    spec.attribute("compression", "zip:2")
    spec.attribute("oiio:ColorSpace", "lin_rec709")
    spec.attribute(*_BLENDER_MARK)
    spec.attribute(_PREFIX + "view_layer", layers.view_layer)
    for key, value in layers.metadata.items():
        spec.attribute(_PREFIX + key, str(value))
    pixels = np.concatenate([layers[name] for name in layers], axis=2)
    return write_whole(path, lambda temporary: _write_image(temporary, spec, pixels))


def _reason(source) -> str:
    """OpenImageIO's last error in one line; source: the module, or an image. A damaged file's own bytes may be in it."""
    try:
        return " ".join(source.geterror().split())
    except UnicodeDecodeError:
        return "it is damaged"


def read_exr(path: str | os.PathLike, view_layer: str | None = None) -> Layers:
    """Read a multilayer OpenEXR: one of `write_exr`, or one of Blender's own with one part or many.

    Passes keep the names of the file ('DiffInd' in Blender 4.5, 'Diffuse Indirect' in 5.2).  Of several
    view layers the one called `view_layer` is read, else the first.

    Raises:
        SceneError: no such file, not an image, or no such view layer.
    """
    path = Path(path)
    if not path.is_file():
        raise SceneError(f"{path} does not exist; give the path of a multilayer EXR file")
    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise SceneError(f"cannot read {path}: {_reason(oiio)}")
    try:
        return _read_parts(image, path, view_layer)
    except UnicodeDecodeError as error:
        raise SceneError(f"cannot read {path}: a name in its header is damaged") from error
    finally:
        image.close()


def _read_parts(image: oiio.ImageInput, path: Path, view_layer: str | None) -> Layers:
    layers = Layers(view_layer=view_layer or "")
    part, own, seen = 0, None, []
    while image.seek_subimage(part, 0):
        spec = image.spec()
        own = own or spec.getattribute(_PREFIX + "view_layer")
        groups = _group_channels(spec.channelnames, own)
        seen += [layer for layer, _ in groups if layer not in seen]
        if view_layer is None and seen:
            view_layer = layers.view_layer = seen[0]
        wanted = {name: channels for (layer, name), channels in groups.items() if layer == view_layer}
        if wanted:
            pixels = image.read_image(part, 0, 0, spec.nchannels, oiio.FLOAT)
            if pixels is None:
                raise SceneError(f"cannot read {path}: {_reason(image)}")
            pixels = pixels.reshape(spec.height, spec.width, spec.nchannels)
            for name, channels in wanted.items():
                layers[name] = np.ascontiguousarray(pixels[..., channels])
            layers.offset = (spec.x - spec.full_x, spec.y - spec.full_y)
            full = (spec.full_width, spec.full_height)
            layers.full_size = full if full != layers.size else None
            for attribute in spec.extra_attribs:
                key = attribute.name.removeprefix(_PREFIX)
                if key != attribute.name and key != "view_layer":
                    layers.metadata[key] = str(attribute.value)
        part += 1
    if not layers:
        raise SceneError(f"{path} holds no layers of a view layer called {view_layer!r}; it has {', '.join(map(repr, seen))}")
    return layers


def _group_channels(names: tuple[str, ...], view_layer: str | None) -> dict[tuple[str, str], list[int]]:
    """(view layer, pass) -> indices of its channels in the order R G B A, X Y Z, or V."""
    groups: dict[tuple[str, str], list[int]] = {}
    for i, name in enumerate(names):
        stem, _, _ = name.rpartition(".")
        if view_layer is not None and stem.startswith(view_layer + "."):
            layer, name_of_pass = view_layer, stem[len(view_layer) + 1 :]
        else:
            layer, _, name_of_pass = stem.rpartition(".")
        groups.setdefault((layer, name_of_pass or "Combined"), []).append(i)
    for channels in groups.values():
        channels.sort(key=lambda i: _ORDER.get(names[i].rpartition(".")[2].upper(), 99))
    return groups


def write_picture(path: str | os.PathLike, image: np.ndarray, metadata: Mapping[str, str] | None = None) -> Path:
    """Write linear values (H, W, 3) as a plain OpenEXR of the channels R, G and B, float32; whole or not at all."""
    spec = oiio.ImageSpec(image.shape[1], image.shape[0], image.shape[2], oiio.FLOAT)
    spec.attribute("compression", "zip:2")
    spec.attribute("oiio:ColorSpace", "lin_rec709")
    for key, value in (metadata or {}).items():
        spec.attribute(_PREFIX + key, str(value))
    return write_whole(path, lambda temporary: _write_image(temporary, spec, np.asarray(image, np.float32)))


def auto_exposure(arrays: Mapping[str, np.ndarray] | list[np.ndarray], percentile: float = 95.0, target: float = 0.8) -> float:
    """Exposure in stops at which `percentile` of the pixels lie below `target`; one value for several layers."""
    values = list(arrays.values()) if isinstance(arrays, Mapping) else arrays
    bright = np.concatenate([a[..., :3].max(axis=-1).ravel() for a in values])
    bright = bright[np.isfinite(bright) & (bright > 0)]
    return float(np.log2(target / np.percentile(bright, percentile))) if bright.size else 0.0


def srgb(linear: np.ndarray) -> np.ndarray:
    """The sRGB transfer function (IEC 61966-2-1) of values clipped to 0..1: Blender's Standard view."""
    linear = np.clip(np.nan_to_num(linear, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)


def write_png(path: str | os.PathLike, image: np.ndarray) -> Path:
    """Write display values (H, W, 3) in 0..1, or uint8, as an 8-bit PNG; whole or not at all."""
    if image.dtype != np.uint8:
        image = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    spec = oiio.ImageSpec(image.shape[1], image.shape[0], image.shape[2], oiio.UINT8)
    spec.attribute("oiio:ColorSpace", "sRGB")
    return write_whole(path, lambda temporary: _write_image(temporary, spec, image))


def write_preview(path: str | os.PathLike, array: np.ndarray, exposure: float = 0.0) -> Path:
    """Write a linear layer (H, W, C) as PNG through the sRGB transfer function, `exposure` stops brighter.

    One channel becomes grey; two are padded with zero; alpha is left out.
    """
    array = np.asarray(array, np.float32)
    array = array[..., None] if array.ndim == 2 else array
    if array.shape[2] == 1:
        array = np.repeat(array, 3, axis=2)
    elif array.shape[2] == 2:
        array = np.concatenate([array, np.zeros_like(array[..., :1])], axis=2)
    return write_png(path, srgb(array[..., :3] * np.float32(2.0**exposure)))
