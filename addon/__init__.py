"""The Blender side: scene extraction, operators, panels, properties, render engine, image layers."""
