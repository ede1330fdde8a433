"""Child process of `clplen.selftest.runner.run_isolated`."""

from __future__ import annotations

import sys

from clplen.selftest.runner import serve

if __name__ == "__main__":
    serve(sys.argv[1], sys.argv[2:])
