#!/usr/bin/env bash
# The documentation site, built as the README says, warnings being errors; its links; docstrings.
#
#   .ci/docs.sh [PYTHON]                                                      (default: python)
#
# PYTHON is the interpreter in whose environment clplen and its test extra are installed.
set -euo pipefail
cd "$(dirname "$0")/.."
python=${1:-python}
folder=$(dirname "$(command -v "$python")")

"$python" -c "import myst_nb, numpydoc, sphinx_click" 2>/dev/null || "$python" -m pip install --quiet ".[docs]"
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
PATH="$folder:$PATH" "$python" -m sphinx -q -W --keep-going docs "$site"
"$python" docs/tools/links.py "$site"
"$python" -m pytest -q -m "thorough or not thorough" tests/test_docstrings.py tests/test_site.py
