"""How far a picture is from its reference (design.md, sections 3 and 6)."""

from __future__ import annotations

import warnings

import numpy as np

from .errors import SceneError

# Share of the reference's squared mean that keeps relative errors of dark pixels finite.
FLOOR = 0.01
# Rec. 709 luminance.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# HDR-FLIP floors luminances near 1e-7 and ends the process below: dimmer references are brightened first.
_FLIP_DIM = 1e-4


def _pair(test: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    test, reference = (np.atleast_3d(np.asarray(a, np.float64)) for a in (test, reference))
    if test.shape != reference.shape:
        raise SceneError(
            f"the test is {test.shape[1]}x{test.shape[0]} with {test.shape[2]} channels, the reference "
            f"{reference.shape[1]}x{reference.shape[0]} with {reference.shape[2]}; render both at one size"
        )
    return test, reference


def valid_pixels(*images: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that are finite in every channel of every image."""
    return np.logical_and.reduce([np.isfinite(np.atleast_3d(image)).all(axis=2) for image in images])


def _denominators(reference: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """r² + e with e = 0.01 mean(r)², of the valid pixels: (N, C)."""
    values = reference[valid]
    return values**2 + FLOOR * values.mean() ** 2


def relmse(test: np.ndarray, reference: np.ndarray) -> float:
    """mean((x - r)² / (r² + e)), e = 0.01 mean(r)², over pixels and channels; invalid pixels left out."""
    test, reference = _pair(test, reference)
    valid = valid_pixels(test, reference)
    return float(np.mean((test[valid] - reference[valid]) ** 2 / _denominators(reference, valid)))


def rmse(test: np.ndarray, reference: np.ndarray) -> float:
    """sqrt(mean((x - r)²)) / mean(r); invalid pixels left out."""
    test, reference = _pair(test, reference)
    valid = valid_pixels(test, reference)
    return float(np.sqrt(np.mean((test[valid] - reference[valid]) ** 2)) / reference[valid].mean())


def bias(test: np.ndarray, reference: np.ndarray) -> float:
    """mean(x - r) / mean(r), signed; invalid pixels left out."""
    test, reference = _pair(test, reference)
    valid = valid_pixels(test, reference)
    return float((test[valid] - reference[valid]).mean() / reference[valid].mean())


def flip(test: np.ndarray, reference: np.ndarray) -> float | None:
    """Mean of NVIDIA's HDR-FLIP (Andersson et al. 2021, at its default 67 pixels per degree).

    Invalid pixels are black in both pictures, negative values zero.  None, with a warning, where the
    package `flip-evaluator` is missing or the reference is black.
    """
    test, reference = _pair(test, reference)
    try:
        import flip_evaluator
    except ImportError:
        warnings.warn("flip is not computed: the package flip-evaluator is not installed", stacklevel=2)
        return None
    valid = valid_pixels(test, reference)[..., None]
    x, r = (np.repeat(a, 3, axis=2) if a.shape[2] == 1 else a[..., :3] for a in (test, reference))
    x, r = (np.where(valid, np.maximum(np.nan_to_num(a), 0), 0) for a in (x, r))
    brightest = float((r @ _LUMINANCE).max())
    if brightest <= 0:
        warnings.warn("flip is not computed: the reference is black", stacklevel=2)
        return None
    scale = 1 / brightest if brightest < _FLIP_DIM else 1.0
    x, r = (np.ascontiguousarray(a * scale, dtype=np.float32) for a in (x, r))
    return float(flip_evaluator.evaluate(r, x, "HDR", applyMagma=False)[1])


def compare(test: np.ndarray, reference: np.ndarray) -> dict:
    """All metrics of one layer.

    Args:
        test, reference: (H, W, C) linear values of one size.

    Returns:
        relmse, rmse, bias, flip (None where undefined: a black reference, no valid pixel), invalid (pixels
        that are NaN or infinite in either; the other figures leave them out), pixels, and
        warnings (lines for the user).

    Raises:
        SceneError: the sizes differ.
    """
    test, reference = _pair(test, reference)
    valid = valid_pixels(test, reference)
    invalid = int(valid.size - valid.sum())
    result: dict = {"relmse": None, "rmse": None, "bias": None, "flip": None, "invalid": invalid, "pixels": int(valid.size), "warnings": []}
    if invalid:
        result["warnings"].append(f"{invalid} of {valid.size} pixels are NaN or infinite; the errors are those of the others")
    if invalid == valid.size:
        return result
    if reference[valid].mean() > 0:
        result |= {"relmse": relmse(test, reference), "rmse": rmse(test, reference), "bias": bias(test, reference)}
    else:
        result["warnings"].append("the reference is black: errors relative to it are undefined")
        return result
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result["flip"] = flip(test, reference)
    result["warnings"] += [str(w.message) for w in caught]
    return result


def reference_noise(half_a: np.ndarray, half_b: np.ndarray, denoised_reference: np.ndarray | None = None) -> float:
    """The share of a relMSE that comes from the noise of the reference (half_a + half_b) / 2.

    Two independent halves a and b of variance v each have E[(a - b)²] = 2 v, and their mean the variance
    v / 2: so mean((a - b)² / 4 / (d² + e)), d the denoised mean, or the mean itself where there is none.
    """
    a, b = _pair(half_a, half_b)
    d = (a + b) / 2 if denoised_reference is None else _pair(denoised_reference, a)[0]
    valid = valid_pixels(a, b, d)
    return float(np.mean((a[valid] - b[valid]) ** 2 / 4 / _denominators(d, valid)))


def reference_doubt(half_a: np.ndarray, half_b: np.ndarray, denoised_reference: np.ndarray) -> float:
    """The standard deviation that the noise of the reference leaves in a `net_relmse`, of pixels whose noise is their own.

    Against halves of errors A and B a pixel's net squared error is (x - t - A) (x - t - B), t being the truth: where the test x is near it,
    A B is left, whose mean is zero.  All tests against the same halves have it in common, and it falls with the samples, not with their root.

    Args:
        half_a, half_b, denoised_reference: (H, W, C) linear values of one size; the last stands for the truth.
    """
    a, b = _pair(half_a, half_b)
    d = _pair(denoised_reference, a)[0]
    valid = valid_pixels(a, b, d)
    left = ((a[valid] - d[valid]) * (b[valid] - d[valid]) / _denominators(d, valid)).mean(axis=-1)
    return float(left.std() / max(1, len(left)) ** 0.5)


def net_relmse(test: np.ndarray, half_a: np.ndarray, half_b: np.ndarray, denoised_reference: np.ndarray | None = None) -> float:
    """relMSE against the mean of two independent halves of a reference, net of that mean's own noise (section 6).

    The denominators come from `denoised_reference`, so that noise does not correlate with them (the mean of
    the halves where it is None).  What `reference_noise` says is subtracted: the result is unbiased, and may
    be negative by chance where the test is better than the reference can tell.

    Args:
        test, half_a, half_b, denoised_reference: (H, W, C) linear values of one size; the test's noise must be
            independent of the halves'.
    """
    x, a = _pair(test, half_a)
    _, b = _pair(test, half_b)
    r = (a + b) / 2
    d = r if denoised_reference is None else _pair(denoised_reference, a)[0]
    valid = valid_pixels(x, a, b, d)
    squared = (x[valid] - r[valid]) ** 2 - (a[valid] - b[valid]) ** 2 / 4
    return float(np.mean(squared / _denominators(d, valid)))


# Colour maps as sRGB control points.  Signed: too dark is blue, right is white, too bright is red.
_SIGNED = np.array([[0.02, 0.19, 0.38], [0.26, 0.58, 0.76], [1, 1, 1], [0.84, 0.38, 0.30], [0.40, 0.0, 0.12]])
# Magnitude: black through violet and orange to pale yellow, of rising luminance.
_MAGNITUDE = np.array([[0.0, 0.0, 0.02], [0.32, 0.07, 0.48], [0.72, 0.22, 0.47], [0.99, 0.53, 0.38], [0.99, 0.99, 0.75]])
_INVALID = np.array([0.0, 1.0, 0.0])


def _colours(values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Map values in 0..1 to the colours of `points`, linearly between them."""
    at = np.linspace(0, 1, len(points))
    return np.stack([np.interp(values, at, points[:, c]) for c in range(3)], axis=-1)


def error_map(test: np.ndarray, reference: np.ndarray, kind: str = "signed", limit: float = 0.5) -> np.ndarray:
    """A picture of the error, (H, W, 3) display values in 0..1; invalid pixels are green.

    kind 'signed': mean over channels of (x - r) / sqrt(r² + e), -limit blue, 0 white, +limit red.
    kind 'relative': square root of each pixel's part of relMSE, 0 black to `limit` pale yellow.
    """
    test, reference = _pair(test, reference)
    valid = valid_pixels(test, reference)
    image = np.broadcast_to(_INVALID, (*valid.shape, 3)).copy()
    if not valid.any():
        return image
    x, r = test[valid], reference[valid]
    scale = np.sqrt(np.maximum(_denominators(reference, valid), np.finfo(np.float64).tiny))
    if kind == "signed":
        image[valid] = _colours(np.clip(((x - r) / scale).mean(axis=1) / limit, -1, 1) * 0.5 + 0.5, _SIGNED)
    elif kind == "relative":
        image[valid] = _colours(np.clip(np.sqrt(np.mean(((x - r) / scale) ** 2, axis=1)) / limit, 0, 1), _MAGNITUDE)
    else:
        raise ValueError(f"kind is {kind!r}; 'signed' or 'relative' is wanted")
    return image
