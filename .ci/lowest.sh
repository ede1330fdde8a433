#!/usr/bin/env bash
# The lowest versions that pyproject.toml admits: the readers and a device with them.
#
#   .ci/lowest.sh [PYTHON]      (default: python3)
#
# A fresh environment of PYTHON gets the lowest version of every package that pyproject.toml names
# (uv's resolution "lowest-direct"; what these need in turn is the newest that fits). Then tests/io
# runs, without fuzzing, and the smoke test of a device. It takes about three minutes on two cores,
# so that CI leaves it out: run it before a release, and after a change of a floor.
set -euo pipefail
cd "$(dirname "$0")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${1:-python3}" -m venv "$work/uv"
"$work/uv/bin/python" -m pip install --quiet uv
# uv does not read pip's settings; those of the environment are handed on.
[ -z "${PIP_FIND_LINKS:-}" ] || export UV_FIND_LINKS=${UV_FIND_LINKS:-$PIP_FIND_LINKS}
[ -z "${PIP_CERT:-}" ] || export SSL_CERT_FILE=${SSL_CERT_FILE:-$PIP_CERT}
uv=$work/uv/bin/uv

"$uv" venv --quiet --python "${1:-python3}" "$work/venv"
python=$work/venv/bin/python
"$uv" pip install --quiet --python "$python" --resolution lowest-direct \
    --requirement pyproject.toml --extra test
"$uv" pip install --quiet --python "$python" --no-deps .
"$uv" pip list --python "$python" |
    grep -iE '^(numpy|scipy|pyopencl|click|tqdm|pydantic|tifffile|imageio|h5py|matplotlib|zarr|filelock|lazy.loader|dask|distributed|fsspec|pytest|hypothesis) '

"$python" -m clplen devices
# Old packages use what newer ones, on which they stand, will drop (matplotlib 3.7 of pyparsing).
"$python" -m pytest tests/io tests/compute/test_device.py tests/lightfield/test_refocus.py \
    -q --device pocl --deselect tests/io/test_fuzz.py -W ignore::DeprecationWarning
