"""`lumigate compare`: the error of one picture against another."""

from __future__ import annotations

from argparse import Namespace

from ..compare import compare_files
from ..console import Terminal


def run(arguments: Namespace, terminal: Terminal) -> None:
    """Print the four metrics, and which of two pictures is better; write figures and error map where asked."""
    compare_files(
        arguments.test,
        arguments.reference,
        arguments.layer,
        arguments.json,
        arguments.error_map,
        half=arguments.half,
        against=arguments.against,
        console=terminal.out,
    )
