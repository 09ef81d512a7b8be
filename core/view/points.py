"""Shading points: where light is computed, once for each distinct surface in a pixel (or lightmap texel)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..lamps.departures import VARIED
from ..surfaces.layout import glossy_rise
from ..threads import run_chunks

BEHIND, SCATTERED = 1, 2  # of `ShadingPoints.behind_glass` and, the latter, `shown`
SPREAD = 3  # further places of a point on its surface
GRAZING = np.float32(-1e-6)  # rounding of the cosine with which a viewer sees the side that is lit
_0 = np.float32(0.0)
_1 = np.float32(1.0)


class ShadingPoints(NamedTuple):
    """N points on surfaces, in the order in which rays from them are coherent.

    position: (N, 3) float32.  error: (N,) float32, radius of the rounding error of the position (m).
    ng, ns: (N, 3) float32, unit geometric and shading normals, on the side that is lit: that of the viewer, or, of a point for the light
        that a translucent surface lets through, the other one.
    pixel: (N,) int32, row-major over the border.  triangle: (N,) int32.
    albedo: (N, 3) float32, diffuse albedo, or transmittance of light from the other side, times the share of the pixel: the pixel's
        diffuse radiance is the sum of albedo * irradiance / pi over its points.
    wo: (N, 3) float32, unit, towards the viewer.
    f0, f90: (N, 3), roughness: (N,) float32, Schlick's glossy lobe (f0 and f90 times the share of the pixel).
    gloss: (N, 4) float32, `layout.GLOSS`.
    behind_glass: (N,) uint8, `BEHIND` where the view passes glass: the pixel shows all light of the point as transmitted light; `SCATTERED` where that is
        frosted: the next sample may show something else.
    spread: (N, SPREAD, 3) float32, where else the pixel shows the surface, as offsets from the position (m); 0 for nowhere.
    facet: (N, SPREAD) int32, their triangles.
    varied: (N, SPREAD + 1, VARIED) float32, by how much the shading normal differs from `ns` and the geometric one from `ng` at the position and at each
        of these places, and the diffuse albedo from the mean of them all, as a part of that of all M samples, times 1 - 1 / M.
    turned: (N, 3, 3) float32, where a glossy pixel shows a surface that turns: its mean shading normal less the point's, then the half axes of the
        rectangle of slopes about it that the pixel's normals fill, each as long as it is wide; else 0.
    tilt: (N,) float32, `layout.TILT` where bumps shadow the light, whose mean is in `albedo`; else 0.
    rough: (N,) float32, `layout.DIFFUSE_ROUGHNESS`.
    sheen: (N, 4) float32, the part (0..1, rgb) of the albedo that is a lobe of `surfaces.sheen`, and its roughness; 0 for none.
    shown: (N,) uint8, not 0 where the surfaces that the lobe shows have points of their own, so that it has to find nothing but what shines; `SCATTERED` where
        these are what single rays through frosted glass have met.
    entered: (N,) uint8, of the back of glass: solids of glass that the view is in by their fronts (see `surfaces.visibility`), and what the lobe shows too.
    """

    position: np.ndarray
    error: np.ndarray
    ng: np.ndarray
    ns: np.ndarray
    pixel: np.ndarray
    triangle: np.ndarray
    albedo: np.ndarray
    wo: np.ndarray
    f0: np.ndarray
    f90: np.ndarray
    roughness: np.ndarray
    behind_glass: np.ndarray
    spread: np.ndarray
    facet: np.ndarray
    varied: np.ndarray
    turned: np.ndarray
    tilt: np.ndarray
    rough: np.ndarray
    sheen: np.ndarray
    gloss: np.ndarray
    shown: np.ndarray
    entered: np.ndarray

    @staticmethod
    def allocate(n: int) -> ShadingPoints:
        """Room for n points, not set but for `behind_glass`, `spread`, `facet`, `varied`, `turned`, `tilt`, `rough`, `sheen`, `gloss`, `shown` and `entered`, which are 0."""
        f, e = np.float32, np.empty
        return ShadingPoints(
            e((n, 3), f), e(n, f), e((n, 3), f), e((n, 3), f), e(n, np.int32), e(n, np.int32),
            e((n, 3), f), e((n, 3), f), e((n, 3), f), e((n, 3), f), e(n, f), np.zeros(n, np.uint8), np.zeros((n, SPREAD, 3), f), np.zeros((n, SPREAD), np.int32), np.zeros((n, SPREAD + 1, VARIED), f),
            np.zeros((n, 3, 3), f), np.zeros(n, f), np.zeros(n, f), np.zeros((n, 4), f), np.zeros((n, 4), f), np.zeros(n, np.uint8), np.zeros(n, np.uint8),
        )  # fmt: skip

    @staticmethod
    def room(n: int) -> ShadingPoints:
        """The same with nothing set: for kernels that make few of the n points that they may, and `blank` those."""
        return ShadingPoints(*(np.empty((n, *a.shape[1:]), a.dtype) for a in ShadingPoints.allocate(0)))

    def take(self, index) -> ShadingPoints:
        """The points at `index` (anything that indexes an array)."""
        return ShadingPoints(*(np.ascontiguousarray(a[index]) for a in self))

    def first(self, n: int) -> ShadingPoints:
        """A copy of the first n points, which does not hold the room of all."""
        return ShadingPoints(*(a[:n].copy() for a in self))

    @staticmethod
    def concatenate(parts: list[ShadingPoints]) -> ShadingPoints:
        """All points of `parts`, in order."""
        if not parts:
            return ShadingPoints.allocate(0)
        fields = list(zip(*parts))
        return ShadingPoints(*run_chunks(lambda k, _: np.concatenate(fields[k]), len(fields), 1))


@inlined
def blank(points, i):
    """Sets of point i what `ShadingPoints.allocate` sets."""
    points.behind_glass[i] = points.shown[i] = points.entered[i] = 0
    points.tilt[i] = points.rough[i] = _0
    for c in range(3):
        for k in range(SPREAD):
            points.spread[i, k, c] = _0
        for k in range(3):
            points.turned[i, k, c] = _0
    for k in range(SPREAD + 1):
        for c in range(VARIED):
            points.varied[i, k, c] = _0
    for k in range(SPREAD):
        points.facet[i, k] = 0
    for c in range(4):
        points.sheen[i, c] = points.gloss[i, c] = _0


@inlined
def further_member(chosen, number, members):
    """Which of a surface's samples, taken in Sobol's order, are a point's further places beside the chosen one: four in succession cover the pixel evenly."""
    places = SPREAD + 1
    return (chosen // places * places + (chosen + number + 1) % places) % members


@inlined
def is_transmitting(points, i):
    """Whether point i is lit on the side that its viewer does not see."""
    return points.ng[i, 0] * points.wo[i, 0] + points.ng[i, 1] * points.wo[i, 1] + points.ng[i, 2] * points.wo[i, 2] < GRAZING


def shares(points: ShadingPoints, wide: float | None = None) -> np.ndarray:
    """Part of its pixel's diffuse albedo that each point is, (N,) float32; 0 where its own is black.

    wide: the glossy albedo of points at least so rough counts, too; None for none.
    """
    albedo = np.einsum("nc->n", points.albedo)
    if wide is not None:
        albedo += np.einsum("nc->n", points.f0) * (points.roughness >= wide)
    whole = np.bincount(points.pixel, albedo)
    return np.divide(albedo, whole[points.pixel], out=np.zeros_like(albedo), where=albedo > 0)


def pixel_maxima(values: np.ndarray, pixel: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(H, W, C) of values (N, C): of a pixel's points the largest counts, so that single marked points are not lost."""
    out = np.zeros((shape[0] * shape[1], values.shape[1]), np.float32)
    np.maximum.at(out, pixel, values)
    return out.reshape(*shape, -1)


@kernel
def glossy_albedos(points):
    """(N, 3) float32: albedo of the points' glossy lobes for their viewers, times the share of the pixel."""
    out = np.empty_like(points.f0)
    for i in range(len(out)):
        cosine = _0
        for c in range(3):
            cosine += points.ns[i, c] * points.wo[i, c]
        rise = glossy_rise(min(max(cosine, _0), _1), points.roughness[i])
        for c in range(3):
            out[i, c] = points.f0[i, c] + rise * (points.f90[i, c] - points.f0[i, c])
    return out
