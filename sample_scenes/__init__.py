"""Scenes built by script."""
