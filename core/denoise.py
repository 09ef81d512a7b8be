"""Denoising of a picture of light: Intel Open Image Denoise by its C interface, or a geometry-aware blur.

Blender ships the library; PyPI `pyoidn` does too.  It is loaded with ctypes from where it lies, so that
this room needs no Blender and no further package.  Where there is none, `Denoiser` blurs and says so.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.util
import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .jit import inlined, kernel, leaf
from .threads import Cancelled, Progress, run_chunks, thread_count

# Values of OpenImageDenoise/oidn.h, versions 2.0 to 2.5.
_DEVICE_CPU = 1
_FLOAT3 = 3
QUALITIES = {"default": 0, "fast": 4, "balanced": 5, "high": 6}
_MONITOR = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_double)  # OIDNProgressMonitorFunction
_LIBRARY_NAMES = ("libOpenImageDenoise.so.2", "libOpenImageDenoise.so", "libOpenImageDenoise.dylib", "OpenImageDenoise.dll")
# Largest factor by which `preserve_mean` scales: beyond it the input's mean is that of a few outliers.
_MEAN_FACTOR = 1.5
# Times the mean of the square of so many pixels to each side, and of the picture: what is so bright is held against the pixels next to it.
FAR_BRIGHTER, AROUND = np.float32(4.0), 7
# Times a pixel's: what is so bright right beside it is another thing, of which a network smears some over the pixel.
BESIDE = np.float32(12.0)
FAINT = 1e-4  # mean radiance, below which a picture is brightened first
ROWS, PLACES = 32, 1024  # of a picture a chunk
# Every picture is mirrored beyond its borders: at a bare corner the network is off by up to 80 %.  8 pixels leave
# 13-15 % less error in a noisy 480x270 for 10 % more time, more pixels no less; a tiny picture needs the wider border.
_PADDING, _TINY, _TINY_PADDING = 8, 32, 32
_BLUR_STEPS = (1, 2, 4, 8)


def _library_folders(hint: str | os.PathLike | None) -> Iterator[Path]:
    """Where the library may lie: what the caller says, Blender's own folders, the wheels of bpy and pyoidn."""
    if hint is not None:
        yield Path(hint)
    # Blender's Python is <blender>/<version>/python, its libraries <blender>/lib or blender.shared.
    blender = Path(sys.prefix).parents[1] if len(Path(sys.prefix).parents) > 1 else Path(sys.prefix)
    yield from (blender / "lib", blender / "blender.shared")
    for package, folders in (("bpy", ("lib", "blender.shared", ".")), ("pyoidn", ("oidn/lib", "oidn/bin"))):
        spec = importlib.util.find_spec(package) if package not in sys.modules else sys.modules[package].__spec__
        if spec is not None and spec.origin:
            yield from (Path(spec.origin).parent / folder for folder in folders)


def find_library(hint: str | os.PathLike | None = None) -> str | None:
    """Path or name of the Open Image Denoise library, None where there is none; `hint`: a file or folder to try first."""
    if hint is not None and Path(hint).is_file():
        return str(hint)
    for folder in _library_folders(hint):
        for name in _LIBRARY_NAMES:
            if (folder / name).is_file():
                return str(folder / name)
    return ctypes.util.find_library("OpenImageDenoise")


def _load(path: str) -> ctypes.CDLL:
    """The library with the signatures of what is called here."""
    if os.name == "nt":
        os.add_dll_directory(str(Path(path).parent))
    lib = ctypes.CDLL(path)
    p, s, n = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t
    signatures = {
        "oidnNewDevice": (p, [ctypes.c_int]),
        "oidnSetDeviceInt": (None, [p, s, ctypes.c_int]),
        "oidnSetDeviceBool": (None, [p, s, ctypes.c_bool]),
        "oidnGetDeviceInt": (ctypes.c_int, [p, s]),
        "oidnGetDeviceError": (ctypes.c_int, [p, ctypes.POINTER(s)]),
        "oidnCommitDevice": (None, [p]),
        "oidnReleaseDevice": (None, [p]),
        "oidnNewFilter": (p, [p, s]),
        "oidnSetSharedFilterImage": (None, [p, s, p, ctypes.c_int, n, n, n, n, n]),
        "oidnSetFilterBool": (None, [p, s, ctypes.c_bool]),
        "oidnSetFilterInt": (None, [p, s, ctypes.c_int]),
        "oidnSetFilterFloat": (None, [p, s, ctypes.c_float]),
        "oidnSetFilterProgressMonitorFunction": (None, [p, _MONITOR, p]),
        "oidnCommitFilter": (None, [p]),
        "oidnExecuteFilter": (None, [p]),
        "oidnReleaseFilter": (None, [p]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    return lib


class DenoiseError(RuntimeError):
    """The library refused a request (out of memory, for one)."""


def channel_means(image: np.ndarray, threads: int = 0) -> np.ndarray:
    """Of an image (H, W, 3): (3,) float64.  NumPy takes 2 ms for 480x270, a twentieth of the time of the network."""
    rows = np.zeros((len(image), 3))
    run_chunks(lambda begin, end: _sum_rows(image, begin, end, rows), len(image), ROWS, threads)
    return rows.sum(axis=0) / max(1, image.shape[0] * image.shape[1])


@kernel
def _sum_rows(image, begin, end, rows):
    for y in range(begin, end):
        r = g = b = 0.0
        for x in range(image.shape[1]):
            r, g, b = r + image[y, x, 0], g + image[y, x, 1], b + image[y, x, 2]
        rows[y, 0], rows[y, 1], rows[y, 2] = r, g, b


def mean_factor(before: np.ndarray, after: np.ndarray, threads: int = 0) -> np.ndarray:
    """What gives the channels of `after` (H, W, 3) the means of `before`: (3,) float32, bounded where those are of outliers."""
    means = [channel_means(image, threads) for image in (before, after)]
    factor = np.divide(*means, out=np.ones(3), where=means[1] > 0)
    return np.clip(factor, 1 / _MEAN_FACTOR, _MEAN_FACTOR).astype(np.float32)


def _with_both_means(before: np.ndarray, after: np.ndarray, threads: int = 0) -> np.ndarray:
    """`after` (H, W, 3) with the means of `before`: those of what is far brighter than the picture, and of the rest, apart.

    A network is off by some percent in what is very bright.  A lampshade may have most of a picture's light: one factor for all would take those
    percent from the table below it.  From the one factor to the other it goes smoothly.
    """
    bright = FAR_BRIGHTER * channel_means(before, threads).astype(np.float32)
    rows = np.zeros((len(after), 3, 5))
    run_chunks(lambda begin, end: _sum_parts(before, after, bright, begin, end, rows), len(after), ROWS, threads)
    factors = np.ones((3, 2), np.float32)
    for factor, (dim, both, far, *wanted) in zip(factors, rows.sum(axis=0), strict=True):
        factor[:] = np.clip(np.linalg.lstsq([[dim, both], [both, far]], wanted, rcond=None)[0], 1 / _MEAN_FACTOR, _MEAN_FACTOR)
    scaled = np.empty_like(after)
    run_chunks(lambda begin, end: _scale_parts(after, bright, factors, begin, end, scaled), len(after), ROWS, threads)
    return scaled


@leaf
def _far_share(image, bright, y, x, c):
    """How much a pixel belongs to what is far brighter, or to its outline: 0 where none next to it has more than `bright`, 1 where one has `FAR_BRIGHTER` times that."""
    value = _brightest(image, y, x, c)
    if not value > bright:
        return np.float32(0)
    return min((value - bright) / ((FAR_BRIGHTER - np.float32(1)) * bright), np.float32(1))


@kernel
def _sum_parts(before, after, bright, begin, end, rows):
    """What the factors of both parts do to their sums, and what these are in `before`: rows (H, 3, 5)."""
    for y in range(begin, end):
        for x in range(after.shape[1]):
            for c in range(3):
                far = _far_share(after, bright[c], y, x, c)
                dim = np.float32(1) - far
                rows[y, c, 0] += dim * dim * after[y, x, c]
                rows[y, c, 1] += dim * far * after[y, x, c]
                rows[y, c, 2] += far * far * after[y, x, c]
                rows[y, c, 3] += dim * before[y, x, c]
                rows[y, c, 4] += far * before[y, x, c]


@kernel
def _scale_parts(after, bright, factors, begin, end, scaled):
    for y in range(begin, end):
        for x in range(after.shape[1]):
            for c in range(3):
                far = _far_share(after, bright[c], y, x, c)
                scaled[y, x, c] = after[y, x, c] * (factors[c, 0] + far * (factors[c, 1] - factors[c, 0]))


def _without_overshoot(before: np.ndarray, after: np.ndarray, threads: int = 0) -> np.ndarray:
    """`after` (H, W, 3), but where it is far brighter than `before` is around there, no brighter than any pixel next to it in `before`.

    The quicker networks make thin bright things, as the lit rim of a shade, up to four times too bright; with the mean preserved, all else
    would be the darker for it.  Wide bright things are no brighter than what is around in them, and stay as they are.
    """
    mean = channel_means(before, threads).astype(np.float32)
    run_chunks(lambda begin, end: _bound_overshoot(before, after, mean, begin, end), len(after), ROWS, threads)
    return after


@kernel
def _bound_overshoot(before, after, mean, begin, end):
    """Bounds the rows begin..end-1 of `after`; mean: (3,) of `before`, which is mirrored at its borders."""
    for y in range(begin, end):
        for x in range(after.shape[1]):
            for c in range(3):
                if after[y, x, c] > FAR_BRIGHTER * mean[c]:
                    after[y, x, c] = _bounded(before, after[y, x, c], mean[c], y, x, c)


@leaf
def _bounded(before, value, mean, y, x, c):
    """`value`, in place of `before` there, bounded by what is around and next to it."""
    most = _usual(before, mean, y, x, c)
    if not value > most:
        return value
    return min(value, max(most, _brightest(before, y, x, c)))


@leaf
def _usual(before, mean, y, x, c):
    """What is not far brighter than the picture, and than what is around there."""
    height, width = before.shape[:2]
    around = np.float32(0)
    for dy in range(-AROUND, AROUND + 1):
        row = _mirrored(y + dy, height)
        for dx in range(-AROUND, AROUND + 1):
            around += before[row, _mirrored(x + dx, width), c]
    return FAR_BRIGHTER * max(mean, around / np.float32((2 * AROUND + 1) ** 2))


@leaf
def _brightest(before, y, x, c):
    """The greatest value of the pixel and of those next to it."""
    most = before[y, x, c]
    for row in range(max(y - 1, 0), min(y + 2, before.shape[0])):
        for column in range(max(x - 1, 0), min(x + 2, before.shape[1])):
            most = max(most, before[row, column, c])
    return most


def _without_smears(before: np.ndarray, after: np.ndarray, threads: int = 0) -> np.ndarray:
    """`after` (H, W, 3), but right beside what is `BESIDE` times as bright no brighter than the pixel and its dark neighbours were in `before`.

    A network draws the outline of a lampshade or of a lamp's fixture a little too wide, by hundredths of what it shows: many times the light
    of the wall behind.  What is bright in `before` alone is noise, beside which all stays as it is.
    """
    clean = after.copy()
    run_chunks(lambda begin, end: _bound_smears(before, after, begin, end, clean), len(after), ROWS, threads)
    return clean


@kernel
def _bound_smears(before, after, begin, end, clean):
    """Bounds the rows begin..end-1 of `clean`, a copy of `after`."""
    height, width = after.shape[:2]
    for y in range(begin, end):
        for x in range(width):
            top, bottom, left, right = max(y - 1, 0), min(y + 2, height), max(x - 1, 0), min(x + 2, width)
            for c in range(3):
                bright = np.float32(0)
                for row in range(top, bottom):
                    for column in range(left, right):
                        bright = max(bright, min(before[row, column, c], after[row, column, c]))
                if not bright > BESIDE * after[y, x, c]:
                    continue
                most = before[y, x, c]
                for row in range(top, bottom):
                    for column in range(left, right):
                        if BESIDE * before[row, column, c] < bright:
                            most = max(most, before[row, column, c])
                clean[y, x, c] = min(clean[y, x, c], most)


def _with_highlights(before: np.ndarray, after: np.ndarray, threads: int = 0) -> np.ndarray:
    """`after` (H, W, 3), in which what is far brighter than its surroundings has the light back that it had in `before`.

    A network takes two thirds of a highlight of one or two pixels; with the mean preserved, all else would be the brighter for it.
    """
    mean = channel_means(before, threads).astype(np.float32)
    places = np.argwhere(after > FAR_BRIGHTER * mean)
    far_brighter = np.empty(len(places), bool)
    run_chunks(lambda begin, end: _mark_far_brighter(before, after, mean, places, begin, end, far_brighter), len(places), PLACES, threads)
    places = places[far_brighter]
    if len(places):
        brightest_first = np.argsort(-after[tuple(places.T)], kind="stable")
        _give_highlights_back(before, after, places[brightest_first])
    return after


@kernel
def _mark_far_brighter(before, after, mean, places, begin, end, far_brighter):
    """Which of the `places` (N, 3: row, column, channel) begin..end-1 are far brighter than what is around there."""
    for place in range(begin, end):
        y, x, c = places[place]
        far_brighter[place] = after[y, x, c] > _usual(before, mean[c], y, x, c)


@kernel
def _give_highlights_back(before, after, places):
    """What the pixels around each of the `places` (N, 3: row, column, channel) have lost, dealt among them by what they had, in this order.

    None becomes brighter than the brightest of them was.
    """
    height, width = before.shape[:2]
    for y, x, c in places:
        top, bottom, left, right = max(y - 1, 0), min(y + 2, height), max(x - 1, 0), min(x + 2, width)
        had = lost = np.float32(0)
        for row in range(top, bottom):
            for column in range(left, right):
                had += before[row, column, c]
                lost += before[row, column, c] - after[row, column, c]
        if not lost > np.float32(0):
            continue
        most = _brightest(before, y, x, c)
        for row in range(top, bottom):
            for column in range(left, right):
                more = after[row, column, c] + lost * before[row, column, c] / had
                after[row, column, c] = max(after[row, column, c], min(more, most))


@inlined
def _mirrored(k, n):
    """The index that stands for k of n, where the row is mirrored at its ends as often as need be."""
    if 0 <= k < n:
        return k
    k %= 2 * n
    return k if k < n else 2 * n - 1 - k


class Denoiser:
    """Denoises pictures; devices and filters are kept from call to call.  Safe to share between threads.

    library: a file or folder where Open Image Denoise lies (found by itself otherwise).
    quality: 'high', 'balanced' or 'fast'.
    progress: is called with the done fraction of each picture, by any thread.
    warning: a line for the user where there is no library and `geometry_aware_blur` stands in, else None.
    version: of the library, as '2.3.3', else None.
    """

    def __init__(self, library: str | os.PathLike | None = None, quality: str = "high", progress: Progress | None = None):
        self._quality = quality
        self.progress = progress
        self._stopped = False
        self._monitor = _MONITOR(self._go_on)
        self._devices: dict[int, int] = {}
        self._filters: dict[tuple, int] = {}
        self._lock = threading.Lock()
        self._lib: ctypes.CDLL | None = None
        self.warning: str | None = None
        self.version: str | None = None
        path = find_library(library)
        try:
            if path is None:
                raise OSError("no such library")
            self._lib = _load(path)
            number = self._lib.oidnGetDeviceInt(self._device(thread_count()), b"version")
            self.version = f"{number // 10000}.{number // 100 % 100}.{number % 100}"
        except (OSError, AttributeError, DenoiseError) as error:
            self.close()
            self._lib = None
            self.warning = (
                f"Open Image Denoise cannot be used ({error}): a geometry-aware blur stands in; install Blender's bpy or PyPI pyoidn for it"
            )

    @property
    def available(self) -> bool:
        """Whether Open Image Denoise is what denoises."""
        return self._lib is not None

    def denoise(
        self,
        color: np.ndarray,
        albedo: np.ndarray | None = None,
        normal: np.ndarray | None = None,
        *,
        position: np.ndarray | None = None,
        clean_aux: bool = False,
        preserve_mean: bool = False,
        highlights: bool = False,
        quality: str | None = None,
        threads: int = 0,
    ) -> np.ndarray:
        """Denoise linear, high-dynamic-range values.

        Args:
            color: (H, W, 3) radiance; negative values count as zero, and a NaN or infinite pixel as the mean of
                its finite neighbours.
            albedo: (H, W, 3) in 0..1;  normal: (H, W, 3), of any length up to 1, zero where nothing is seen.
            position: (H, W, 3) m, read only by the blur that stands in.
            clean_aux: the guides have no noise (see `prefilter`); edges in them are then kept sharp.
            preserve_mean: scale each channel so that its mean is the input's (by 1/1.5 to 1.5 at most); of what is far brighter than the picture
                apart, where `highlights` are no noise.
            highlights: what stays far brighter than its surroundings is no noise: it keeps its light, and none is smeared over what is beside it.
            quality: for this picture, None for the denoiser's own.  Of clean guides 'high' makes a larger network, at twice the time.
            threads: 0 is all.

        Returns:
            (H, W, 3) float32, finite, not negative.

        Raises:
            DenoiseError: the library failed, as for want of memory.
            core.threads.Cancelled: `progress` returned False.
        """
        color = _finite_neighbours(np.maximum(_image(color), 0))
        mean = float(channel_means(color, threads).mean())
        if 0 < mean < FAINT:  # the library's own exposure ends there
            scale = np.float32(min(1 / mean, 1e30))
            settings = dict(position=position, clean_aux=clean_aux, preserve_mean=preserve_mean, highlights=highlights)
            return self.denoise(scale * color, albedo, normal, quality=quality, threads=threads, **settings) / scale
        guides = {"albedo": albedo, "normal": normal}
        guides = {name: np.nan_to_num(_image(guide, color), posinf=0, neginf=0) for name, guide in guides.items() if guide is not None}
        if position is not None:
            position = _image(position, color)
        if not color.any():  # the network would make up a faint pattern
            return color
        if "normal" in guides and "albedo" not in guides:
            # The library takes a normal only beside an albedo: a grey one says nothing.
            guides["albedo"] = np.full_like(color, 0.5)
        if self._lib is None:
            clean = geometry_aware_blur(color, guides.get("normal"), position, guides.get("albedo"), threads=threads)
        else:
            images = {"color": color, **guides}
            clean = _without_overshoot(
                color, self._execute(images, threads, hdr=True, clean_aux=clean_aux and bool(guides), quality=quality), threads
            )
            if highlights:
                clean = _with_highlights(color, _without_smears(color, clean, threads), threads)
        if not preserve_mean:
            return clean
        if highlights:
            return _with_both_means(color, clean, threads)
        return clean * mean_factor(color, clean, threads)

    def prefilter(self, kind: str, guide: np.ndarray, *, quality: str | None = None, threads: int = 0) -> np.ndarray:
        """A guide (H, W, 3), 'albedo' or 'normal', without its noise, for `clean_aux`; unchanged without the library."""
        guide = np.nan_to_num(_image(guide), posinf=0, neginf=0)
        return guide if self._lib is None else self._execute({kind: guide}, threads, quality=quality)

    def _device(self, threads: int) -> int:
        if threads not in self._devices:
            device = self._lib.oidnNewDevice(_DEVICE_CPU)
            if not device:
                raise DenoiseError(self._error(None) or "no CPU device")
            self._devices[threads] = device
            self._lib.oidnSetDeviceInt(device, b"numThreads", threads)
            # Pinning would bind this process's other pools to the library's cores.
            self._lib.oidnSetDeviceBool(device, b"setAffinity", False)
            self._lib.oidnCommitDevice(device)
            self._check(device)
        return self._devices[threads]

    def _execute(
        self, images: dict[str, np.ndarray], threads: int, hdr: bool = False, clean_aux: bool = False, quality: str | None = None
    ) -> np.ndarray:
        threads = thread_count(threads)
        rows, columns = next(iter(images.values())).shape[:2]
        pad = _TINY_PADDING if min(rows, columns) < _TINY else _PADDING
        images = {name: np.pad(image, ((pad, pad), (pad, pad), (0, 0)), "symmetric") for name, image in images.items()}
        output = np.empty_like(next(iter(images.values())))
        height, width = output.shape[:2]
        with self._lock:
            device = self._device(threads)
            # One filter a set of images, for another set is another network to load.
            quality = quality or self._quality
            key = (threads, hdr, clean_aux, quality, *sorted(images))
            if key not in self._filters:
                self._filters[key] = self._lib.oidnNewFilter(device, b"RT")
                self._lib.oidnSetFilterBool(self._filters[key], b"hdr", hdr)
                self._lib.oidnSetFilterBool(self._filters[key], b"cleanAux", clean_aux)
                self._lib.oidnSetFilterInt(self._filters[key], b"quality", QUALITIES[quality])
                self._lib.oidnSetFilterProgressMonitorFunction(self._filters[key], self._monitor, None)
            network = self._filters[key]
            for name, image in (*images.items(), ("output", output)):
                self._lib.oidnSetSharedFilterImage(network, name.encode(), image.ctypes.data, _FLOAT3, width, height, 0, 0, 0)
            self._lib.oidnCommitFilter(network)
            self._stopped = False
            self._lib.oidnExecuteFilter(network)
            error = self._error(device)
            if self._stopped:  # which the library reports as an error, too
                raise Cancelled
            if error:
                raise DenoiseError(f"Open Image Denoise failed: {error}")
        return np.ascontiguousarray(output[pad : pad + rows, pad : pad + columns])

    def _go_on(self, _: int | None, done: float) -> bool:
        """What the library asks now and then; once it has heard no, it asks no more."""
        self._stopped = self._stopped or (self.progress is not None and not self.progress(done))
        return not self._stopped

    def _error(self, device: int | None) -> str | None:
        message = ctypes.c_char_p()
        code = self._lib.oidnGetDeviceError(device, ctypes.byref(message))
        return (message.value or b"unknown error").decode(errors="replace") if code else None

    def _check(self, device: int) -> None:
        error = self._error(device)
        if error:
            raise DenoiseError(f"Open Image Denoise failed: {error}")

    def close(self) -> None:
        """Release the library's memory; the next call takes it again."""
        with self._lock:
            for network in self._filters.values():
                self._lib.oidnReleaseFilter(network)
            for device in self._devices.values():
                self._lib.oidnReleaseDevice(device)
            self._filters.clear()
            self._devices.clear()


def _image(array: np.ndarray, like: np.ndarray | None = None) -> np.ndarray:
    """`array` as the library and the kernels read it: they trust its shape, so it is checked here."""
    array = np.ascontiguousarray(array, np.float32)
    if array.ndim != 3 or array.shape[2] != 3:
        raise ValueError(f"the picture has the shape {array.shape}; wanted (height, width, 3)")
    if like is not None and array.shape != like.shape:
        raise ValueError(f"the guide has the shape {array.shape}, the picture {like.shape}; wanted the same")
    return array


def _finite_neighbours(color: np.ndarray) -> np.ndarray:
    """`color` with each pixel that is not finite replaced by the mean of the finite ones around it, 0 if there are none."""
    finite = np.isfinite(color)
    if finite.all():
        return color
    bad = ~finite.all(axis=2)
    values = np.pad(np.where(bad[..., None], 0, color), ((1, 1), (1, 1), (0, 0)))
    counts = np.pad(~bad, 1).astype(np.float32)
    fixed = color.copy()
    rows, columns = np.nonzero(bad)
    total, count = np.zeros((len(rows), 3), np.float32), np.zeros(len(rows), np.float32)
    for dy in range(3):
        for dx in range(3):
            total += values[rows + dy, columns + dx]
            count += counts[rows + dy, columns + dx]
    fixed[rows, columns] = total / np.maximum(count, 1)[:, None]
    return fixed


def pull_push(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """`image` (H, W, 3) with holes where `known` (H, W) is False filled from around them, coarsely where they are wide; zero if nothing is known.

    Gortler, Grzeszczuk, Szeliski & Cohen 1996, The Lumigraph, Section 3.4.
    """
    if known.all() or not known.any():
        return image
    height, width = known.shape
    pad = (0, height % 2), (0, width % 2)
    weight = np.pad(known, pad).astype(np.float32)[..., None]
    image = np.pad(image, (*pad, (0, 0))) * weight
    total, count = (part[0::2, 0::2] + part[1::2, 0::2] + part[0::2, 1::2] + part[1::2, 1::2] for part in (image, weight))
    coarse = pull_push(total / np.maximum(count, np.float32(1)), count[..., 0] > 0)
    around = coarse.repeat(2, axis=0).repeat(2, axis=1)
    return np.where(weight > 0, image, around)[:height, :width]


@kernel
def _blur_rows(light, normal, position, albedo, step, begin, end, out):
    """One a-trous pass over the rows begin..end: 5x5 taps `step` pixels apart, weighted by how alike the surfaces are."""
    height, width = light.shape[0], light.shape[1]
    taps = (np.float32(0.0625), np.float32(0.25), np.float32(0.375), np.float32(0.25), np.float32(0.0625))
    zero, tiny = np.float32(0), np.float32(1e-12)
    # Scale-free edges: 0.1 is the sine of the angle at which a point leaves the plane of the other.
    plane_scale, albedo_scale = np.float32(1 / 0.1**2), np.float32(1 / 0.1**2)
    for y in range(begin, end):
        for x in range(width):
            total = zero
            r, g, b = zero, zero, zero
            lit = normal[y, x, 0] ** 2 + normal[y, x, 1] ** 2 + normal[y, x, 2] ** 2 > zero
            for j in range(5):
                yy = y + (j - 2) * step
                if yy < 0 or yy >= height:
                    continue
                for i in range(5):
                    xx = x + (i - 2) * step
                    if xx < 0 or xx >= width:
                        continue
                    weight = taps[i] * taps[j]
                    cosine, off, apart, tint = zero, zero, zero, zero
                    for c in range(3):
                        cosine += normal[y, x, c] * normal[yy, xx, c]
                        d = position[yy, xx, c] - position[y, x, c]
                        off += d * normal[y, x, c]
                        apart += d * d
                        tint += (albedo[yy, xx, c] - albedo[y, x, c]) ** 2
                    if lit:
                        weight *= max(cosine, zero) ** 16 * np.exp(-off * off / (apart + tiny) * plane_scale)
                    elif normal[yy, xx, 0] ** 2 + normal[yy, xx, 1] ** 2 + normal[yy, xx, 2] ** 2 > zero:
                        weight = zero
                    weight *= np.exp(-tint * albedo_scale)
                    total += weight
                    r += weight * light[yy, xx, 0]
                    g += weight * light[yy, xx, 1]
                    b += weight * light[yy, xx, 2]
            if total > zero:
                out[y, x, 0], out[y, x, 1], out[y, x, 2] = r / total, g / total, b / total
            else:
                out[y, x, 0], out[y, x, 1], out[y, x, 2] = light[y, x, 0], light[y, x, 1], light[y, x, 2]


def geometry_aware_blur(
    color: np.ndarray,
    normal: np.ndarray | None = None,
    position: np.ndarray | None = None,
    albedo: np.ndarray | None = None,
    *,
    threads: int = 0,
) -> np.ndarray:
    """Blur light within surfaces: a-trous wavelet passes of 5x5 taps (Dammertz et al. 2010), 61 pixels wide in all.

    The light is divided by the albedo first and multiplied after, so that textures stay sharp; normals, planes
    and albedo stop the blur at edges.  Noise of single bright pixels spreads instead of going away.

    Args:
        color: (H, W, 3) finite radiance;  normal, position, albedo: (H, W, 3) guides, or None.
        threads: 0 is all; the result does not depend on it.

    Returns:
        (H, W, 3) float32.
    """
    color = _image(color)
    albedo = np.full_like(color, 0.5) if albedo is None else _image(albedo, color)
    facing = np.zeros_like(color)
    facing[..., 2] = 1
    if normal is not None:
        length = np.linalg.norm(_image(normal, color), axis=2, keepdims=True)
        facing = np.divide(normal, length, out=np.zeros_like(color), where=length > 0)
    position = np.zeros_like(color) if position is None else np.nan_to_num(_image(position, color), posinf=0, neginf=0)
    divisor = np.where(albedo > 1e-3, albedo, 1).astype(np.float32)
    light = color / divisor
    for step in _BLUR_STEPS:
        out = np.empty_like(light)
        source = light

        def rows(begin: int, end: int, source=source, out=out, step=step) -> None:
            _blur_rows(source, facing, position, albedo, step, begin, end, out)

        run_chunks(rows, color.shape[0], 16, threads)
        light = out
    return light * divisor
