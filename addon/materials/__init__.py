"""The compiler from Blender's shader node trees to the programs of core/surfaces."""

from .compile import compile_materials
from .requests import AttributeRequest, CompiledMaterials, LampProgram, LampUse, MaterialUse, Shot

__all__ = ["AttributeRequest", "CompiledMaterials", "LampProgram", "LampUse", "MaterialUse", "Shot", "compile_materials"]
