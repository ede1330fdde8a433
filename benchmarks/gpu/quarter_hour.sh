#!/usr/bin/env bash
# What a GPU that is at hand for a quarter of an hour is used for, in order of worth.
#
#   benchmarks/gpu/quarter_hour.sh STAGES OUT
#
# STAGES   names with commas between them. First call: check,forms,speed. Second call, after the first
#          was read: variants,suite.
#   check     every kernel once against its twin in float64
#   forms     tests of kernels with the work-items of GPUs, of transforms and of memory
#   speed     copies; steps and stacks beside PyTorch and CuPy; depth, exposure, deconvolution
#   variants  forms of the refocusing kernel, time of each kernel, lenses, gradients, series
#   suite     the other tests that take a device, until the time is up
# OUT      folder for log.txt (all that was printed) and results.json (a row a step, written after each)
#
# $CLPLEN_DEVICE chooses the device (default: gpu), $PYTHON the interpreter, $SECONDS_AT_MOST the length
# of the call (300), $WORKERS the processes of tests (11). QUICK=1 takes small sizes and few tests, to see
# on a CPU that the script works.
set -uo pipefail
stages=${1:?"usage: quarter_hour.sh STAGES OUT"} out=${2:?"usage: quarter_hour.sh STAGES OUT"}
mkdir -p "$out" && out=$(cd "$out" && pwd) || exit 1
cd "$(dirname "$0")/../.."

python=${PYTHON:-python3}
export CLPLEN_DEVICE=${CLPLEN_DEVICE:-gpu} PYTHONPATH=$PWD${PYTHONPATH:+:$PYTHONPATH} PYTHONUNBUFFERED=1
PYTHONPATH=$PWD/benchmarks/gpu:$PYTHONPATH
export JAX_PLATFORMS=cpu # JAX would take three quarters of a GPU's memory
at_most=${SECONDS_AT_MOST:-300} workers=${WORKERS:-11} quick=${QUICK:+--quick}
log=$out/log.txt results=$out/results.json
printed=$(mktemp)
trap 'rm -f "$printed"' EXIT

# step NAME LIMIT COMMAND...: runs it for LIMIT seconds or what is left of the call, and adds its row.
step() {
    local name=$1 limit=$2 left=$((at_most - SECONDS - 5)) begun=$EPOCHREALTIME code=0
    shift 2
    [ "$left" -ge "$limit" ] || limit=$left
    if [ "$limit" -lt 5 ]; then
        echo "== $name: no time is left" | tee -a "$log"
        return
    fi
    echo "== $SECONDS s: $name, $limit s at most: $*" | tee -a "$log"
    timeout --signal=INT --kill-after=8 "$limit" "$@" >"$printed" 2>>"$log" || code=$?
    cat "$printed" >>"$log"
    "$python" - "$results" "$printed" "$name" "$code" "$begun" "$EPOCHREALTIME" "$*" <<'ROW'
import json, pathlib, sys

kept, printed, name, code, begun, ended, command = sys.argv[1:]
text, file = pathlib.Path(printed).read_text(errors="replace"), pathlib.Path(kept)
try:
    found = json.loads(text)
except ValueError:
    found = text.splitlines()[-40:]
row = {
    "step": name, "command": command, "exit": int(code), "seconds": float(ended) - float(begun),
    "printed": found,
}
rows = json.loads(file.read_text()) if file.exists() else []
file.write_text(json.dumps([*rows, row], indent=1) + "\n")
lines = found
if isinstance(found, dict):  # of `clplen bench`
    lines = [
        f"{report['size']:18s} {entry['name']:40s} {entry['seconds'] * 1e3:9.3f} ms {entry['ratio'] or 0:8.3f}"
        for report in found["reports"] for entry in report["rows"]
    ]
print(f"   exit {code} after {row['seconds']:.0f} s", *lines[-30:], sep="\n   ")
ROW
}

# bench NAME LIMIT [SIZE]: `clplen bench` at its own sizes, at SIZE, or at its small one.
bench() { step "$1${3:+ $3}" "$2" "$python" -m clplen bench "$1" --json ${quick:-${3:+--size "$3"}}; }

tests() {
    step "$1" "$2" "$python" -m pytest -q -n "$workers" --device "$CLPLEN_DEVICE" --device-tests-only \
        --tb=no -p print_failures --no-header -p no:cacheprovider -p no:benchmark "${@:3}"
}

check() {
    step "devices" 10 "$python" -m clplen devices
    step "check" 40 "$python" -m clplen devices --check --device "$CLPLEN_DEVICE"
}

forms() {
    local files=(tests/kernels tests/compute tests/wave/test_propagation.py tests/wave/test_adjoint.py)
    [ -z "$quick" ] || files=(tests/kernels/test_multiply.py tests/kernels/test_lenslets.py)
    tests forms 100 --mapping sample "${files[@]}"
}

speed() {
    step "copies" 20 "$python" -m benchmarks gpu/copies --device "$CLPLEN_DEVICE" $quick
    step "by hand" 50 "$python" -m benchmarks gpu/by_hand --device "$CLPLEN_DEVICE" $quick
    step "three passes" 20 "$python" -m benchmarks gpu/three_passes --device "$CLPLEN_DEVICE" $quick
    bench transfers 20
    bench propagation 25
    bench depth 40
    bench camera 25
    bench microscope 30 17x67
    bench stack 25
}

variants() {
    local form
    for form in samples staged; do
        echo "CLPLEN_SHEAR=$form"
        CLPLEN_SHEAR=$form bench stack 20 9x9x512x512
    done
    step "profile of steps" 25 "$python" -m clplen bench propagation --profile ${quick:---size 2048}
    step "profile of depth" 40 "$python" -m clplen bench depth --profile $quick
    bench fields 25
    bench gradients 30
    bench series 60
}

suite() {
    local files=(tests --ignore tests/kernels --ignore tests/compute)
    [ -z "$quick" ] || files=(tests/wave/test_lens.py tests/lightfield/test_refocus.py)
    tests suite "$at_most" "${files[@]}"
}

IFS=, read -ra wanted <<<"$stages"
for name in "${wanted[@]}"; do
    case $name in
        check | forms | speed | variants | suite) ;;
        *) echo "quarter_hour.sh: there is no stage '$name'" >&2; exit 2 ;;
    esac
done
for name in "${wanted[@]}"; do $name; done
echo "== $SECONDS s: done"
