"""Discrete distributions: alias tables (constant time) and cumulative sums (ordered, keep stratification)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel

_BELOW_ONE = np.float32(0.99999994)
_1 = np.float32(1.0)


class AliasTable(NamedTuple):
    """Vose's alias table of n outcomes.

    threshold: (n,) float32, share of column i that is i itself;  alias: (n,) int32, the rest of the column;
    probability: (n,) float32.
    """

    threshold: np.ndarray
    alias: np.ndarray
    probability: np.ndarray


@kernel(fast=False)
def _fill_alias(scaled, threshold, alias):
    """Vose's two worklists; `scaled` (n,) float64 has mean 1 and is overwritten."""
    n = scaled.shape[0]
    small = np.empty(n, np.int32)
    large = np.empty(n, np.int32)
    n_small = 0
    n_large = 0
    for i in range(n):
        if scaled[i] < 1.0:
            small[n_small] = i
            n_small += 1
        else:
            large[n_large] = i
            n_large += 1
    while n_small > 0 and n_large > 0:
        n_small -= 1
        s = small[n_small]
        g = large[n_large - 1]
        threshold[s] = scaled[s]
        alias[s] = g
        scaled[g] -= 1.0 - scaled[s]
        if scaled[g] < 1.0:
            n_large -= 1
            small[n_small] = g
            n_small += 1


def alias_table(weights: np.ndarray) -> AliasTable:
    """Alias table of non-negative weights (n,); uniform where all of them are zero (Vose 1991)."""
    weights = np.asarray(weights, np.float64)
    n = len(weights)
    total = weights.sum()
    probability = weights / total if total > 0 else np.full(n, 1.0 / max(n, 1))
    threshold, alias = np.ones(n, np.float32), np.arange(n, dtype=np.int32)
    _fill_alias(probability * n, threshold, alias)
    # What rounding leaves on the lists is a full column, but an outcome without weight must never be drawn.
    empty = (probability == 0) & (alias == np.arange(n))
    if n:
        threshold[empty], alias[empty] = 0.0, int(np.argmax(probability))
    return AliasTable(threshold, alias, probability.astype(np.float32))


@inlined
def sample_alias(table, u):
    """Outcome for u in [0, 1) -> (index, u remapped to [0, 1) for further use)."""
    n = table.threshold.shape[0]
    x = u * np.float32(n)
    i = min(np.int64(x), n - 1)
    f = min(x - np.float32(i), _BELOW_ONE)
    t = table.threshold[i]
    if f < t:
        return i, min(f / t, _BELOW_ONE)
    return np.int64(table.alias[i]), min((f - t) / (_1 - t), _BELOW_ONE)


def cumulative(weights: np.ndarray, dtype=np.float32) -> np.ndarray:
    """CDFs along the last axis: (..., n) weights -> (..., n + 1) of `dtype`, from 0 to 1.

    Rows without any weight become uniform.  Summed in float64; the result never decreases.  Take float64
    (and a float64 u) where single outcomes may be rarer than 1e-5.
    """
    weights = np.asarray(weights, np.float64)
    n = weights.shape[-1]
    total = weights.sum(-1, keepdims=True)
    p = np.where(total > 0, weights / np.where(total > 0, total, 1.0), 1.0 / max(n, 1))
    cdf = np.zeros((*weights.shape[:-1], n + 1))
    np.cumsum(p, -1, out=cdf[..., 1:])
    cdf /= cdf[..., -1:]
    return cdf.astype(dtype)


@inlined
def sample_cdf(cdf, u):
    """Outcome for u in [0, 1) of a CDF (n + 1,) -> (index, u remapped to [0, 1), probability).

    Consecutive u give consecutive outcomes, so that stratified u stay stratified within each outcome.
    Outcomes without probability are never returned.
    """
    low = 0
    high = cdf.shape[0] - 1
    while high - low > 1:
        middle = (low + high) >> 1
        if cdf[middle] <= u:
            low = middle
        else:
            high = middle
    p = cdf[low + 1] - cdf[low]
    return low, np.float32(min((u - cdf[low]) / p, _BELOW_ONE)), p
