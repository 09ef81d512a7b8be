"""Nodes that turn a temperature or a wavelength into a colour."""

from __future__ import annotations

import functools

import numpy as np

from ....core.surfaces import outlined
from ..builder import Table, Value, scalar
from ..registry import value
from ..tree import NodeInput

_XYZ_TO_RGB = np.array([[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]])
_COLDEST, _HOTTEST = 800.0, 12000.0  # Cycles holds the colour beyond these
_SHORTEST, _LONGEST = 380.0, 780.0
_ROWS = 512


# CIE 1931 2 degree colour matching functions x, y, z from 380 to 780 nm in steps of 10 nm (ISO/CIE 11664-1).
_MATCHING = np.array([
    [0.0014, 0.0042, 0.0143, 0.0435, 0.1344, 0.2839, 0.3483, 0.3362, 0.2908, 0.1954, 0.0956, 0.032, 0.0049, 0.0093, 0.0633, 0.1655, 0.2904, 0.4334, 0.5945, 0.7621, 0.9163, 1.0263, 1.0622, 1.0026, 0.8544, 0.6424, 0.4479, 0.2835, 0.1649, 0.0874, 0.0468, 0.0227, 0.0114, 0.0058, 0.0029, 0.0014, 0.0007, 0.0003, 0.0002, 0.0001, 0],
    [0, 0.0001, 0.0004, 0.0012, 0.004, 0.0116, 0.023, 0.038, 0.06, 0.091, 0.139, 0.208, 0.323, 0.503, 0.71, 0.862, 0.954, 0.995, 0.995, 0.952, 0.87, 0.757, 0.631, 0.503, 0.381, 0.265, 0.175, 0.107, 0.061, 0.032, 0.017, 0.0082, 0.0041, 0.0021, 0.001, 0.0005, 0.0002, 0.0001, 0.0001, 0, 0],
    [0.0065, 0.0201, 0.0679, 0.2074, 0.6456, 1.3856, 1.7471, 1.7721, 1.6692, 1.2876, 0.813, 0.4652, 0.272, 0.1582, 0.0782, 0.0422, 0.0203, 0.0087, 0.0039, 0.0021, 0.0017, 0.0011, 0.0008, 0.0003, 0.0002, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
])  # fmt: skip


def _matching(wavelength: np.ndarray) -> np.ndarray:
    """(N, 3) colour matching functions at wavelengths in nm."""
    table = np.linspace(_SHORTEST, _LONGEST, _MATCHING.shape[1])
    return np.stack([np.interp(wavelength, table, column) for column in _MATCHING], 1)


@functools.cache
def _blackbody_table() -> Table:
    """Colours of luminance 1, equidistant in 1 / temperature from the hottest to the coldest."""
    temperature = 1 / np.linspace(1 / _HOTTEST, 1 / _COLDEST, _ROWS)
    wavelength = np.arange(_SHORTEST, _LONGEST + 1, 10.0)
    # Planck's law in nm and K; constant factors fall out.
    radiance = 1 / (wavelength**5 * np.expm1(1.4387769e7 / (wavelength * temperature[:, None])))
    xyz = radiance @ _matching(wavelength)
    rgb = np.maximum(xyz / xyz[:, 1:2] @ _XYZ_TO_RGB.T, 0)
    return Table(tuple((*map(float, row), 1.0) for row in rgb))


@functools.cache
def _wavelength_table() -> Table:
    """Colours of single wavelengths; the factor is the one of Cycles' node, which keeps them below 1."""
    wavelength = np.linspace(_SHORTEST, _LONGEST, _ROWS)
    rgb = np.maximum(_matching(wavelength) @ _XYZ_TO_RGB.T / 2.52, 0)
    return Table(tuple((*map(float, row), 1.0) for row in rgb))


def _looked_up(node: NodeInput, table: Table, at: Value, low: float, high: float) -> Value:
    t = node.math("DIVIDE", node.math("SUBTRACT", at, scalar(low)), scalar(high - low))
    return node.emit(outlined.RAMP, t, table, p=_ROWS * 4 + 1)


@value("ShaderNodeBlackbody")
def blackbody(node: NodeInput, output: str) -> Value:
    """Blackbody (within 2 % of Cycles' own fit)."""
    inverse = node.math("DIVIDE", scalar(1), node.math("MAXIMUM", node["Temperature"], scalar(1)))
    return _looked_up(node, _blackbody_table(), inverse, 1 / _HOTTEST, 1 / _COLDEST)


@value("ShaderNodeWavelength")
def wavelength(node: NodeInput, output: str) -> Value:
    """Wavelength."""
    return _looked_up(node, _wavelength_table(), node["Wavelength"], _SHORTEST, _LONGEST)
