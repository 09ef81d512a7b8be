"""What the system lets this process have, looked at before libraries are loaded that wait for ever, or die, where it is too little."""

from __future__ import annotations

LEAST_ADDRESSES = 7 << 28  # bytes of address space, 1.75 GiB: Blender, Numba and Embree by themselves take 1.6


def shortage() -> str | None:
    """Why nothing can be loaded under this process's limits, and what to do; None where it can."""
    try:
        import resource
    except ImportError:  # Windows has no such limits
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY or limit >= LEAST_ADDRESSES:
        return None
    return (
        f"this process may have {limit / 2**30:.2g} GiB of addresses, and its libraries alone take {LEAST_ADDRESSES / 2**30:.2g}: "
        "raise the limit (ulimit -v unlimited)"
    )
