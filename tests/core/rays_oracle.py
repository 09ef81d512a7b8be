"""Slow, readable oracles for rays against triangles, in float64."""

import numpy as np


def moeller_trumbore(vertices, triangles, origins, directions):
    """(t, inside) of N rays and T triangles, (N, T) each.

    inside is the smallest barycentric weight of the hit with the triangle's plane: the ray meets the
    triangle where it is >= 0; NaN for a triangle without area or with a corner that is not finite.
    Moeller and Trumbore 1997, "Fast, minimum storage ray/triangle intersection".
    """
    with np.errstate(all="ignore"):
        a, b, c = (vertices[triangles[:, k]].astype(np.float64)[None] for k in range(3))
        o, d = origins.astype(np.float64)[:, None], directions.astype(np.float64)[:, None]
        e1, e2 = b - a, c - a
        p = np.cross(d, e2)
        det = (e1 * p).sum(-1)
        s = o - a
        u = (s * p).sum(-1) / det
        q = np.cross(s, e1)
        v = (d * q).sum(-1) / det
        t = (e2 * q).sum(-1) / det
        inside = np.minimum(np.minimum(u, v), 1 - u - v)
        usable = np.isfinite(vertices[triangles]).all(axis=(1, 2)) & (np.linalg.norm(np.cross(e1, e2)[0], axis=1) > 0)
    return np.where(usable, t, np.nan), np.where(usable, inside, np.nan)


def assert_hits(hits, oracle, vertices, triangles, seen, origins, directions, t_max, tolerance=1e-4):
    """Check nearest hits: what is surely met is found, and what is found is met, within `tolerance` at the borders.

    oracle: what `moeller_trumbore` said of these rays.  seen: (T,) bool, triangles that these rays can meet at all.  t_max: (N,).
    """
    t, inside = oracle
    with np.errstate(invalid="ignore"):
        sure = seen & (inside > tolerance) & (t > tolerance) & (t < t_max[:, None] - tolerance)
    nearest = np.where(sure, t, np.inf).min(axis=1)
    found = hits.triangle >= 0
    assert np.array_equal(found | ~np.isfinite(nearest), np.ones(len(found), bool)), "a sure hit was missed"
    assert np.all(hits.t[found] <= nearest[found] + tolerance), "a nearer triangle was overlooked"
    ray = np.flatnonzero(found)
    triangle = hits.triangle[ray]
    assert np.all(seen[triangle])
    assert np.all(inside[ray, triangle] > -tolerance), "a triangle was hit beside it"
    assert np.allclose(t[ray, triangle], hits.t[ray], atol=tolerance, rtol=tolerance)
    u, v = hits.u[ray, None].astype(np.float64), hits.v[ray, None].astype(np.float64)
    corner = vertices[triangles[triangle]].astype(np.float64)
    point = (1 - u - v) * corner[:, 0] + u * corner[:, 1] + v * corner[:, 2]
    assert np.allclose(point, origins[ray] + hits.t[ray, None].astype(np.float64) * directions[ray], atol=10 * tolerance)


def assert_occluded(occluded, oracle, seen, t_max, tolerance=1e-4):
    """Check any-hit answers; what only the border of a triangle or of the range decides may go either way."""
    t, inside = oracle
    with np.errstate(invalid="ignore"):
        sure = seen & (inside > tolerance) & (t > tolerance) & (t < t_max[:, None] - tolerance)
        possible = seen & (inside > -tolerance) & (t > -tolerance) & (t < t_max[:, None] + tolerance)
    assert np.all(occluded[sure.any(axis=1)] == 1)
    assert np.all(occluded[~possible.any(axis=1)] == 0)
