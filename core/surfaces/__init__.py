"""Surfaces: what a material does with light at a hit point (programs, textures, GGX albedo tables)."""
