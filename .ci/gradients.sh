#!/usr/bin/env bash
# Operators in graphs of PyTorch and JAX.
#
#   .ci/gradients.sh [PYTHON] [install|test]...                 (default: python, install test)
#
# PYTHON is the interpreter in whose environment clplen and its test extra are installed.
#
#   install   PyTorch and JAX for CPUs from PyPI. The version of PyTorch is one whose wheel brings no
#             libraries of a GPU, which would be gigabytes.
#   test      the tests that need them, and the page on training, whose blocks are run; on every
#             OpenCL device of the machine, or on that of $CLPLEN_DEVICE
set -euo pipefail
cd "$(dirname "$0")/.."
python=${1:-python}
steps=("${@:2}")

install() {
    "$python" -c "import torch, jax" 2>/dev/null || "$python" -m pip install --quiet "torch==2.13.0" jax
}

run_tests() {
    local device=()
    [ -z "${CLPLEN_DEVICE:-}" ] || device=(--device "$CLPLEN_DEVICE")
    "$python" -m pytest -q -m "not nightly" "${device[@]}" tests/gradients tests/test_foreign_arrays.py
    "$python" -m pytest -q -m "not nightly" tests/test_docs.py -k train_with_torch
}

for step in "${steps[@]:-install test}"; do
    case $step in
        install) install ;;
        test) run_tests ;;
        "install test") install && run_tests ;;
        *) echo "gradients.sh: there is no step '$step'" >&2; exit 1 ;;
    esac
done
