"""What the frames of a sequence share: tables of what did not change, and the light that earlier frames found."""

from .sequence import Sequence

__all__ = ["Sequence"]
