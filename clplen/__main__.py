"""Entry point of ``python -m clplen``, equal to the command ``clplen``."""

from clplen.cli import main

main(prog_name="clplen")
