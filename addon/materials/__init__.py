"""The compiler from Blender's shader node trees to the programs of core/surfaces."""

from .compile import compile_materials
from .requests import AttributeRequest, CompiledMaterials, MaterialUse

__all__ = ["AttributeRequest", "CompiledMaterials", "MaterialUse", "compile_materials"]
