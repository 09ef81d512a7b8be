"""Shader nodes: closures with the weight that the mix shaders above leave them."""

from __future__ import annotations

from ....core.surfaces import program as ops
from ....core.surfaces.closures import BECKMANN
from ..builder import ONE, ZERO, Constant, Value, scalar
from ..registry import closure
from ..requests import WORLD_NORMAL
from ..tree import NodeInput

# Nodes whose normals have a length of 1.
_UNIT_NORMALS = frozenset({"ShaderNodeBump", "ShaderNodeNormalMap", "ShaderNodeNewGeometry"})
_NEXT_TO_NOTHING = 1e-12
_COS_82 = 1 / 7  # cosine of what is called 82 degrees in F82


def _is(value: Value, number: float) -> bool:
    """Whether a value is known to be this number."""
    return isinstance(value, Constant) and value.rgb == (number, number, number)


def _multiple(node: NodeInput) -> int:
    """1 where the node's microfacet distribution keeps the light scattered more than once."""
    return int(node.node.distribution == "MULTI_GGX")


def _normal(node: NodeInput, key: str = "Normal") -> None:
    """The shading normal of a linked normal input, else the one that the material's displacement bends."""
    if node.has(key) and node.linked(key):
        corrected = getattr(getattr(node.context.material, "cycles", None), "use_bump_map_correction", True)
        normal = node[key]
        if node.scope.source(node.socket(key)).socket.node.bl_idname not in _UNIT_NORMALS:
            # As Cycles, the surface's own where it is none.
            surface = node.program.attribute(WORLD_NORMAL)
            normal = node.vector("NORMALIZE", node.vector("MULTIPLY_ADD", surface, scalar(_NEXT_TO_NOTHING), normal))
        node.emit(ops.NORMAL_MAP, normal, node.program.attribute(WORLD_NORMAL), p=int(corrected))
    elif node.has(key) and node.context.normal is not None:
        # To Cycles it is the surface's own: no bump that it could correct.
        node.emit(ops.NORMAL_MAP, node.context.normal, node.program.attribute(WORLD_NORMAL), p=0)


def _has_own_normal(node: NodeInput) -> bool:
    """Whether the coat of a Principled node lies smoothly over its bumps; warns where it has others."""
    bumpy = node.linked("Normal")
    if not node.linked("Coat Normal"):
        return bumpy  # what displaces the surface bends its coat, too
    sources = [node.scope.source(node.socket(key)) for key in ("Coat Normal", "Normal")]
    if not bumpy or sources[0].socket != sources[1].socket:
        node.warn("the coat's own normal is left out: it shines by that of what lies below")
    return False


def _warn_straight(node: NodeInput, what: str) -> None:
    node.warn(f"{what} bends what the camera sees and the light of lamps; other light goes straight through")


def _warn_anisotropy(node: NodeInput, key: str) -> None:
    if node.has(key) and not _is(node[key], 0):
        node.warn("anisotropy is left out: highlights and reflections are round")


def _warn_film(node: NodeInput) -> None:
    if node.has("Thin Film Thickness") and not _is(node["Thin Film Thickness"], 0):
        node.warn("the thin film is left out: its colours do not show")


@closure("ShaderNodeBsdfPrincipled")
def principled(node: NodeInput, weight: Value) -> None:
    """Principled BSDF v2: alpha, sheen, coat, emission, metal, transmission, dielectric over diffuse."""
    _normal(node)
    multiple = _multiple(node)
    alpha = node.clamp(node["Alpha"])
    if not _is(alpha, 1):
        node.emit(ops.TRANSPARENT_CLOSURE, ONE, ZERO, ZERO, node.multiply(weight, node.complement(alpha)))
        weight = node.multiply(weight, alpha)
    if weight == ZERO:
        return
    base, roughness, ior = node["Base Color"], node["Roughness"], node["IOR"]
    sheen = node["Sheen Weight"]
    if not _is(sheen, 0):
        lobe = node.pack(sheen, node["Sheen Roughness"])
        weight = node.emit(ops.SHEEN_CLOSURE, lobe, node["Sheen Tint"], ZERO, weight)
    _warn_anisotropy(node, "Anisotropic")
    _warn_film(node)
    coat = node["Coat Weight"]
    if not _is(coat, 0):
        lobe = node.pack(coat, node["Coat Roughness"], node["Coat IOR"])
        weight = node.emit(ops.COAT_CLOSURE, lobe, node["Coat Tint"], ZERO, weight, p=int(_has_own_normal(node)))
    emission = node.multiply(node["Emission Color"], node["Emission Strength"])
    if emission != ZERO:
        node.emit(ops.EMISSION_CLOSURE, emission, ZERO, ZERO, weight)
    tint = node["Specular Tint"]
    metallic = node.clamp(node["Metallic"])
    thin = node.has("Thin Wall") and _is(node["Thin Wall"], 1)
    if not _is(metallic, 0):
        node.emit(ops.METAL_CLOSURE, base, roughness, tint, node.multiply(weight, metallic), p=multiple)
        weight = node.multiply(weight, node.complement(metallic))
    transmission = node.clamp(node["Transmission Weight"])
    if not _is(transmission, 0):
        through = node.clamp(base) if thin else node.math_rgb("SQRT", node.clamp(base))  # of both sides, or one
        share = node.multiply(weight, transmission)
        node.emit(
            ops.GLASS_CLOSURE, through, node.pack(roughness, ior), tint, share, p=ops.THIN_WALL * thin | ops.SCATTERED_ONCE * (1 - multiple)
        )
        weight = node.multiply(weight, node.complement(transmission))
        _warn_straight(node, "transmission")
    subsurface = node.clamp(node["Subsurface Weight"])
    if thin:
        # Blender 5.2: what would scatter below the surface leaves either side of it.
        through = node.multiply(subsurface, node.math_rgb("MULTIPLY_ADD", node["Subsurface Anisotropy"], scalar(0.5), scalar(0.5)))
        if not _is(through, 0) and weight != ZERO:
            node.emit(ops.TRANSLUCENT_CLOSURE, node.multiply(base, through), ZERO, ZERO, weight, p=1)
            base = node.multiply(base, node.complement(through))
    elif not _is(subsurface, 0):
        node.warn("subsurface scattering is treated as diffuse reflection with the base colour")
    if weight != ZERO:
        lobe = node.pack(roughness, ior, node["Specular IOR Level"], node["Diffuse Roughness"] if node.has("Diffuse Roughness") else ZERO)
        node.emit(ops.DIELECTRIC_CLOSURE, base, lobe, tint, weight, p=multiple)


@closure("ShaderNodeBsdfDiffuse")
def diffuse(node: NodeInput, weight: Value) -> None:
    """Diffuse BSDF."""
    _normal(node)
    node.emit(ops.DIFFUSE_CLOSURE, node["Color"], node["Roughness"], ZERO, weight)


@closure("ShaderNodeBsdfTranslucent")
def translucent(node: NodeInput, weight: Value) -> None:
    """Translucent BSDF: diffuse transmission."""
    _normal(node)
    node.emit(ops.TRANSLUCENT_CLOSURE, node["Color"], ZERO, ZERO, weight)


@closure("ShaderNodeSubsurfaceScattering")
def subsurface(node: NodeInput, weight: Value) -> None:
    """Subsurface Scattering: diffuse with its colour."""
    node.warn("subsurface scattering is treated as diffuse reflection with its colour")
    _normal(node)
    node.emit(ops.DIFFUSE_CLOSURE, node["Color"], ZERO, ZERO, weight)


@closure("ShaderNodeBsdfSheen")
def sheen(node: NodeInput, weight: Value) -> None:
    """Sheen BSDF, microfibre or Ashikhmin's velvet."""
    _normal(node)
    velvet = int(node.node.distribution != "MICROFIBER")
    node.emit(ops.SHEEN_CLOSURE, node.pack(ONE, node["Roughness"]), node["Color"], ZERO, weight, p=velvet)


@closure("ShaderNodeBsdfToon")
def toon(node: NodeInput, weight: Value) -> None:
    """Toon BSDF: diffuse or glossy with its colour, without the steps."""
    node.warn("a Toon BSDF is treated as a plain diffuse or glossy one")
    _normal(node)
    if node.node.component == "GLOSSY":
        node.emit(ops.GLOSSY_CLOSURE, node["Color"], node["Size"], ZERO, weight)
    else:
        node.emit(ops.DIFFUSE_CLOSURE, node["Color"], ZERO, ZERO, weight)


@closure("ShaderNodeBsdfAnisotropic", "ShaderNodeBsdfGlossy")
def glossy(node: NodeInput, weight: Value) -> None:
    """Glossy BSDF."""
    _normal(node)
    _warn_anisotropy(node, "Anisotropy")
    kind = BECKMANN if node.node.distribution == "BECKMANN" else _multiple(node)
    node.emit(ops.GLOSSY_CLOSURE, node["Color"], node["Roughness"], ZERO, weight, p=kind)


def _conductor_edge(node: NodeInput, base: Value, n: Value, k2: Value) -> Value:
    """The tint at 82 degrees of a conductor: its reflectance there (Rs and Rp of a large n^2 + k^2) over Schlick's, which rises from `base` to 1."""
    c, twice = scalar(_COS_82), node.vector("MULTIPLY", scalar(2 * _COS_82), n)
    size = node.vector("MULTIPLY_ADD", n, n, k2)
    parts = []
    for a, b in ((size, node.vector("MULTIPLY", c, c)), (node.vector("MULTIPLY", size, node.vector("MULTIPLY", c, c)), ONE)):
        whole = node.vector("ADD", a, b)
        parts.append(node.vector("DIVIDE", node.vector("SUBTRACT", whole, twice), node.vector("ADD", whole, twice)))
    reflected = node.vector("MULTIPLY", scalar(0.5), node.vector("ADD", *parts))
    schlick = node.vector("MULTIPLY_ADD", node.complement(base), scalar((1 - _COS_82) ** 5), base)
    return node.vector("DIVIDE", reflected, schlick)


@closure("ShaderNodeBsdfMetallic")
def metallic(node: NodeInput, weight: Value) -> None:
    """Metallic BSDF: by base colour and edge tint (F82), or by the conductor's n and k."""
    _normal(node)
    _warn_anisotropy(node, "Anisotropy")
    _warn_film(node)
    base, edge = node["Base Color"], node["Edge Tint"]
    if node.node.fresnel_type == "PHYSICAL_CONDUCTOR":
        n, k = node["IOR"], node["Extinction"]
        one = ONE
        k2 = node.vector("MULTIPLY", k, k)
        above = node.vector("SUBTRACT", n, one)
        below = node.vector("ADD", n, one)
        base = node.vector("DIVIDE", node.vector("MULTIPLY_ADD", above, above, k2), node.vector("MULTIPLY_ADD", below, below, k2))
        edge = _conductor_edge(node, base, n, k2)
    node.emit(ops.METAL_CLOSURE, base, node["Roughness"], edge, weight, p=_multiple(node))


@closure("ShaderNodeBsdfGlass")
def glass(node: NodeInput, weight: Value) -> None:
    """Glass BSDF: through with its colour, blurred but not bent."""
    _warn_straight(node, "glass")
    _warn_film(node)
    color = node["Color"]
    node.emit(
        ops.GLASS_CLOSURE, color, node.pack(node["Roughness"], node["IOR"]), color, weight, p=ops.SCATTERED_ONCE * (1 - _multiple(node))
    )


@closure("ShaderNodeBsdfRefraction")
def refraction(node: NodeInput, weight: Value) -> None:
    """Refraction BSDF: through with its colour, blurred but not bent."""
    _warn_straight(node, "refraction")
    node.emit(ops.REFRACTION_CLOSURE, node["Color"], node.pack(node["Roughness"], node["IOR"]), ZERO, weight)


@closure("ShaderNodeBsdfTransparent")
def transparent(node: NodeInput, weight: Value) -> None:
    """Transparent BSDF."""
    node.emit(ops.TRANSPARENT_CLOSURE, node["Color"], ZERO, ZERO, weight)


@closure("ShaderNodeEmission", "ShaderNodeBackground")
def emission(node: NodeInput, weight: Value) -> None:
    """Emission; Background on a surface is the same."""
    color = node.multiply(node["Color"], node["Strength"])
    if color != ZERO:
        node.emit(ops.EMISSION_CLOSURE, color, ZERO, ZERO, weight)


@closure("ShaderNodeMixShader")
def mix_shader(node: NodeInput, weight: Value) -> None:
    """Mix Shader: the factor's share of the second shader, the rest of the first."""
    factor = node.clamp(node[0])
    for socket, share in ((node.socket(1), node.complement(factor)), (node.socket(2), factor)):
        node.scope.shade(socket, node.multiply(weight, share))


@closure("ShaderNodeAddShader")
def add_shader(node: NodeInput, weight: Value) -> None:
    """Add Shader: both."""
    node.scope.shade(node.socket(0), weight)
    node.scope.shade(node.socket(1), weight)


@closure("ShaderNodeHoldout")
def holdout(node: NodeInput, weight: Value) -> None:
    """Holdout: black."""
    node.warn("a Holdout shows as black")


@closure("ShaderNodeBsdfHair", "ShaderNodeBsdfHairPrincipled")
def hair(node: NodeInput, weight: Value) -> None:
    """Hair shaders on a surface: diffuse with their colour."""
    node.warn("a hair shader is treated as diffuse with its colour")
    node.emit(ops.DIFFUSE_CLOSURE, node["Color"] if node.has("Color") else scalar(0.5), ZERO, ZERO, weight)
