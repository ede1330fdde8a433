"""The command ``clplen``: what users type comes in; calls of the package, files and text leave."""

from clplen.cli.app import main

__all__ = ["main"]
