"""Which materials gather rays follow as they follow mirrors."""

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.surfaces.brushed import with_brushed
from lumigate.core.surfaces.layout import DIFFUSE, GLOSSY_F0, ROUGHNESS
from lumigate.core.surfaces.program import END, GLOSSY_CLOSURE, REGISTERS

NOWHERE = np.zeros((0, 1, 3, 4), np.float32)


@pytest.mark.parametrize("roughness, albedo, brushed", [(0.3, 0.1, True), (0.3, 0.8, False), (0.7, 0.1, False)])
def test_a_narrow_lobe_that_reflects_more_than_what_is_diffuse_is_brushed(build, roughness, albedo, brushed):
    tables = build.materials((albedo, 0.0), (0.5, 0.0)).tables
    tables.constant[0, GLOSSY_F0 : GLOSSY_F0 + 3], tables.constant[0, ROUGHNESS] = 0.6, roughness
    found = with_brushed(tables, np.zeros(1, np.int32), NOWHERE)
    assert list(found.flags & sc.BRUSHED > 0) == [brushed, False]
    assert not (tables.flags & sc.BRUSHED).any()
    tables.constant[0, DIFFUSE : DIFFUSE + 3] = 1
    assert not (with_brushed(found._replace(constant=tables.constant), np.zeros(1, np.int32), NOWHERE).flags & sc.BRUSHED).any()


@pytest.mark.parametrize("roughness, brushed", [(0.3, True), (0.8, False)])
def test_materials_of_nodes_are_looked_at(build, roughness, brushed):
    tables = build.materials((0.5, 0.0), (0.5, 0.0)).tables
    code = np.zeros((3, 8), np.int32)
    code[:, 0] = END
    code[1] = GLOSSY_CLOSURE, 0, REGISTERS, REGISTERS + 1, REGISTERS, REGISTERS, REGISTERS, 0
    constants = np.array([[0.8, 0.8, 0.8, 1], [roughness, 0, 0, 0]], np.float32)
    tables = tables._replace(code=code, constants=constants)
    tables.start[1], tables.flags[1] = 1, sc.GLOSSY_LOBE
    material = np.array([0, 1, 1], np.int32)
    found = with_brushed(tables, material, np.zeros((0, 3, 3, 4), np.float32))
    assert list(found.flags & sc.BRUSHED > 0) == [False, brushed]
