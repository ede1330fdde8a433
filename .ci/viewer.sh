#!/usr/bin/env bash
# The viewer: lint of its JavaScript by Biome, its pages in Chromium, their contrast by axe-core.
#
#   .ci/viewer.sh [PYTHON] [fetch|test]...        (default: python, both)
#
# PYTHON is the interpreter in whose environment clplen and its test extra are installed.
#
#   fetch   installs Debian's Chromium, playwright, and Biome and axe-core from npm into $CLPLEN_NODE
#           (default: a folder beside this one's checkout, node/)
#   test    lints, and runs the tests marked `browser`
#
# Without npm there is neither lint nor axe-core, which is said.
set -euo pipefail
cd "$(dirname "$0")/.."

biome=2.6.8 axe=4.14.1
node=${CLPLEN_NODE:-$PWD/node}

as_root() {
    if [ "$(id -u)" -eq 0 ]; then "$@"; else sudo -n "$@"; fi
}

fetch() {
    if [ ! -x "${CLPLEN_CHROMIUM:-/usr/bin/chromium}" ]; then
        as_root apt-get install -y -qq chromium >/dev/null 2>&1 ||
            { as_root apt-get update -qq && as_root apt-get install -y -qq chromium >/dev/null; }
    fi
    "$python" -c "import playwright" 2>/dev/null || "$python" -m pip install --quiet ".[browser]"
    if command -v npm >/dev/null; then
        mkdir -p "$node"
        npm install --prefix "$node" --no-audit --no-fund --silent "@biomejs/biome@$biome" "axe-core@$axe"
    fi
}

run_tests() {
    if [ -x "$node/node_modules/.bin/biome" ]; then
        "$node/node_modules/.bin/biome" lint --error-on-warnings clplen/viewer/page
    else
        echo "no npm: the viewer's JavaScript is not linted, and axe-core judges no page"
    fi
    CLPLEN_AXE="$node/node_modules/axe-core/axe.min.js" \
        "$python" -m pytest -m "browser and not nightly" -n 1 -q tests/viewer
}

python=python
if [ $# -gt 0 ] && [ "$1" != fetch ] && [ "$1" != test ]; then python=$1; shift; fi
[ $# -gt 0 ] || set -- fetch test
for step in "$@"; do
    case $step in
    fetch) fetch ;;
    test) run_tests ;;
    *) echo "viewer.sh: $step is neither fetch nor test" >&2; exit 1 ;;
    esac
done
