"""Light transport on arrays: no Blender in here (import-linter checks it)."""
