"""``python -m clplen`` is the command ``clplen``."""

from clplen.cli import main

main(prog_name="clplen")
