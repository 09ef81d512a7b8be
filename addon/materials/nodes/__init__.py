"""The functions of the node types; importing this package fills the tables of `registry`."""

from . import colors, images, inputs, lights, procedural, shaders, spectra, vectors

__all__ = ["colors", "images", "inputs", "lights", "procedural", "shaders", "spectra", "vectors"]
