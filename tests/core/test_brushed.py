"""Which materials reflect mostly by a lobe."""

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.surfaces.brushed import with_brushed
from lumigate.core.surfaces.layout import DIFFUSE, GLOSSY_F0, ROUGHNESS
from lumigate.core.surfaces.program import ATTRIBUTE, END, GLOSSY_CLOSURE, REGISTERS

SQUARES = 4


@pytest.fixture
def squares(build):
    """Geometry of SQUARES quads of the material 0."""
    corners = [[(x, 0, 0), (x + 1, 0, 0), (x + 1, 1, 0), (x, 1, 0)] for x in range(SQUARES)]
    return build.geometry(*build.quads(*corners), material=np.zeros(2 * SQUARES, np.int32))


def looking(build, *looks):
    """Tables of materials of these (reflectance of the lobe, roughness, diffuse colour)."""
    tables = build.materials(*[(diffuse, 0.0) for _, _, diffuse in looks]).tables
    for surface, (shine, roughness, diffuse) in zip(tables.constant, looks, strict=True):
        surface[GLOSSY_F0 : GLOSSY_F0 + 3], surface[ROUGHNESS], surface[DIFFUSE : DIFFUSE + 3] = shine, roughness, diffuse
    return tables._replace(flags=tables.flags | np.int32(sc.GLOSSY_LOBE))


def is_marked(tables, geometry):
    return (with_brushed(tables, geometry).flags & sc.BRUSHED > 0).tolist()


def test_metal_is_but_neither_varnish_nor_blasted_metal(build, squares):
    assert is_marked(looking(build, (0.9, 0.4, 0.0), (0.04, 0.4, 0.5), (0.9, 0.8, 0.0)), squares) == [True, False, False]


def test_gather_rays_follow_metal_alone(build, squares):
    marked = with_brushed(looking(build, (0.9, 0.4, 0.0), (0.3, 0.4, 0.25), (0.9, 0.8, 0.0)), squares)
    assert (marked.flags & sc.METAL > 0).tolist() == [True, False, False]
    assert (marked.flags & sc.BRUSHED > 0).tolist() == [True, True, False]


def test_a_mark_of_before_does_not_stay(build, squares):
    tables = looking(build, (0.04, 0.4, 0.5))
    assert is_marked(tables._replace(flags=tables.flags | np.int32(sc.BRUSHED)), squares) == [False]


@pytest.mark.parametrize("blasted, expected", [(0, True), (1, True), (3, False), (4, False)])
def test_textured_metal_is_what_it_is_at_most_places(build, squares, blasted, expected):
    """Metal whose roughness is an attribute: .9 on some of the squares, .4 on the others."""
    tables = looking(build, (0.0, 0.0, 0.5))
    code = [[ATTRIBUTE, 0, 0, 0, 0, 0, 0, 0], [GLOSSY_CLOSURE, 1, REGISTERS, 0, REGISTERS, REGISTERS, REGISTERS, 0], [END] + [0] * 7]
    tables = tables._replace(
        code=np.array(code, np.int32),
        constants=np.ones((1, 4), np.float32),
        start=np.zeros(1, np.int32),
        flags=np.array([sc.GLOSSY_LOBE], np.int32),
    )
    squares.attributes = np.full((1, 2 * SQUARES, 3, 4), 0.4, np.float32)
    squares.attributes[0, : 2 * blasted] = 0.9
    assert is_marked(tables, squares) == [expected]
