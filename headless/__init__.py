"""Without a window: the command line, Cycles references, the benchmark, frame and lightmap drivers."""
