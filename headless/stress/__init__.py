"""Numerical stability under stress: cases and random scenes, each with what must hold (`lumigate bench stress`)."""
