"""The methods, one file each, all of one shape: `prepare(...)`, then `irradiance(points) -> (N, 3)`."""
