#!/usr/bin/env bash
# The documentation site, built as the README says, warnings being errors; its links; docstrings.
#
#   .ci/docs.sh [PYTHON] [install|build]...                      (default: python, install build)
#
# PYTHON is the interpreter in whose environment clplen and its test extra are installed.
#
#   install   Sphinx and its extensions from PyPI
#   build     the site, with tutorials that run, its links, its search and layout where Chromium and
#             playwright are installed (with axe-core of viewer.sh), tests of docstrings
set -euo pipefail
cd "$(dirname "$0")/.."
python=${1:-python}
[ $# -gt 0 ] && shift
[ $# -gt 0 ] || set -- install build

install() {
    "$python" -c "import myst_nb, numpydoc, sphinx_click" 2>/dev/null ||
        "$python" -m pip install --quiet ".[docs]"
}

build() {
    local folder
    folder=$(dirname "$(command -v "$python")")
    site=$(mktemp -d)
    trap 'rm -rf "$site"' EXIT
    PATH="$folder:$PATH" "$python" -m sphinx -q -W --keep-going docs "$site"
    "$python" docs/tools/links.py "$site"
    if [ -x "${CLPLEN_CHROMIUM:-/usr/bin/chromium}" ] && "$python" -c "import playwright" 2>/dev/null; then
        "$python" docs/tools/search.py "$site"
        CLPLEN_AXE="${CLPLEN_NODE:-$PWD/node}/node_modules/axe-core/axe.min.js" \
            "$python" docs/tools/pages.py "$site" | grep -v "first paint"
    else
        echo "no Chromium: neither the search nor the layout of the pages is checked"
    fi
    "$python" -m pytest -q -m "thorough or not thorough" tests/test_docstrings.py tests/test_site.py
}

for step in "$@"; do
    case $step in
    install | build) "$step" ;;
    *) echo "docs.sh: $step is neither install nor build" >&2; exit 1 ;;
    esac
done
