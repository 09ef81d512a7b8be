"""Shadow maps: visibility of many points from one, read from depths instead of traced."""
