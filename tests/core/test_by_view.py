"""Diffuse light by the angle of the view."""

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.methods.exchange import Probes
from lumigate.core.methods.light_cache import _of_all_views
from lumigate.core.surfaces import ggx
from lumigate.core.surfaces.by_view import VIEWS, differences, views
from lumigate.core.surfaces.layout import (
    DIFFUSE,
    DIFFUSE_ROUGHNESS,
    GLOSSY_F0,
    GLOSSY_F90,
    LAYER_F0,
    LAYER_MULTIPLE,
    LAYER_ROUGHNESS,
    LAYER_Z,
    LAYERED,
    ROUGHNESS,
)


def varnished(build, roughness):
    """Two materials: a grey one, and one under a dielectric lobe."""
    materials = build.materials((0.6, 0.0), (0.6, 0.0))
    surface = materials.tables.constant[1]
    surface[LAYERED : LAYERED + 3] = surface[DIFFUSE]
    surface[LAYER_F0], surface[LAYER_Z] = 0.04, ggx.ior_coordinate(1.5)
    surface[LAYER_ROUGHNESS] = surface[ROUGHNESS] = roughness
    surface[LAYER_MULTIPLE] = 1
    surface[GLOSSY_F0 : GLOSSY_F0 + 3], surface[GLOSSY_F90 : GLOSSY_F90 + 3] = 0.04, 1
    return materials.tables


def table_of(tables):
    return views(tables, np.array([0, 1], np.int32), np.zeros((0, 2, 3, 4), np.float32), threads=1)[0]


@pytest.mark.parametrize("roughness", [0.05, 0.2, 0.5, 1.0])
def test_the_mean_over_all_views_is_none_of_them(build, roughness):
    table = table_of(varnished(build, roughness))
    cosine = np.sqrt((np.arange(4096) + 0.5) / 4096).astype(np.float32)  # cosine-distributed
    one = np.ones(len(cosine), np.int32)
    for side in (2, 3):
        assert differences(table, side * one, cosine).mean() == pytest.approx(0, abs=0.004)
    assert not differences(table, 0 * one, cosine).any()


def test_grazing_views_see_less_under_a_sharp_lobe(build):
    table = table_of(varnished(build, 0.1))
    low, high = differences(table, [2, 2], [0.1, 1.0])
    assert low < -0.3 and 0.02 < high < 0.1


def test_rough_diffuse_surfaces_count(build):
    tables = varnished(build, 0.5)
    tables.constant[0, DIFFUSE_ROUGHNESS] = 1
    assert table_of(tables)[0].any()


def test_what_comes_through_is_left_alone(build):
    tables = varnished(build, 0.1)
    tables.flags[1] |= sc.TRANSLUCENT
    assert table_of(tables).shape == (4, VIEWS)
    assert not table_of(tables).any()


def test_probes_tell_the_mean_of_all_views_whichever_theirs_is(build):
    """But for what a narrow lobe has reflected, and without a spark where they see next to nothing."""
    table = table_of(varnished(build, 0.0))
    probes = Probes.allocate(3)
    probes.side[:], probes.cosine[:], probes.valid[:] = 2, (1.0, 0.3, 0.0), 1
    seen = 1 + differences(table, probes.side, probes.cosine)
    probes.shine[:] = 0.5
    probes.direct[:] = 0.5 + seen[:, None]
    direct = _of_all_views(probes, table).direct[:, 0]
    np.testing.assert_allclose(direct[:2], 1.5, rtol=1e-5)
    assert 0.5 <= direct[2] <= 1.5
