"""The repository's root is the package `lumigate`: pyproject cannot say that of all its folders, so this does."""

from setuptools import find_packages, setup

rooms = find_packages(include=["core*", "addon*", "headless*", "sample_scenes*"])
setup(package_dir={"lumigate": "."}, packages=["lumigate", *(f"lumigate.{room}" for room in rooms)])
