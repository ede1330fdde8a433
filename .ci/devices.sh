#!/usr/bin/env bash
# The device matrix: the same tests on independent OpenCL implementations.
#
#   .ci/devices.sh [PYTHON] [MODE]...                                (default: python, all of these)
#
# PYTHON is the interpreter in whose environment clplen and its test extra are installed. Every mode
# installs what it needs.
#
#   install   what vkfft, intel and oclgrind need, and no tests
#   pocl      the whole suite on PoCL, which `pip install clplen` brings
#   vkfft     the FFT tests on PoCL with VkFFT, built here for OpenCL
#   intel     the tests of kernels and devices, less the thorough ones, on
#             Intel's CPU runtime (which is installed here from PyPI and runs on AMD processors too).
#             clplen shows it to the OpenCL loader by itself. Kernels have the mapping of
#             work-items of CPUs.
#   intel-both  the kernels with the mapping of GPUs too; not part of CI
#   intel-towers  the same of the towers and the cameras; not part of CI, whose time is limited
#   oclgrind  tests/kernels on Debian's simulator Oclgrind, with no report of an access out of
#             bounds or of a data race; of stored samples uint8 and float32, and of waves those in single
#             precision, since all are indexed alike; every other file with the mapping of work-items
#             of CPUs, the rest with that of GPUs
#   oclgrind-both  the same with both mappings of every file; not part of CI
#   rusticl   the tests of kernels and devices on Mesa's OpenCL, which drives AMD and Intel GPUs
#             under Linux, here on its CPU, llvmpipe: single precision alone. Not part of CI: one
#             and a half minutes on two cores.
#   debian-pocl  the same on Debian's and Ubuntu's PoCL, another version with another LLVM than the
#             one from pip. Not part of CI: five minutes on two cores. The package stays installed,
#             and from then on the machine has two devices that `--device pocl` fits.
#
# How Mesa's and Debian's drivers are reached. An ICD file with the path of the library, in a
# temporary folder named by OCL_ICD_VENDORS, so that no other driver of the machine is seen but PoCL
# from pip, which pyopencl's own loader adds; it lends its double precision as a reference. rusticl
# shows llvmpipe only where RUSTICL_ENABLE=llvmpipe.
#
# How Oclgrind is reached. Its wrapper preloads liboclgrind-rt.so, which stands in for the OpenCL
# loader; pyopencl's wheel, although it has a loader of its own, then sees one platform,
# "Oclgrind", with one device, "Oclgrind Simulator", so `--device oclgrind` selects it by name.
# (An ICD file with the path of /usr/lib/oclgrind/liboclgrind-rt-icd.so in a folder named by
# OCL_ICD_VENDORS shows it beside the other platforms; OCL_ICD_FILENAMES has no effect. Debian
# installs no ICD file for it.)
#
# How its reports are counted. `oclgrind --log FILE` empties the file at every new OpenCL context,
# so reports of earlier contexts are lost. They are therefore read from stderr, and pytest runs
# with --capture=sys, because --capture=fd would keep them for itself. Every report holds one line
# "Kernel: NAME".
set -euo pipefail
cd "$(dirname "$0")/.."

fail() { echo "devices.sh: $*" >&2; exit 1; }

need_intel() {
    "$python" -m pip show --quiet intel-opencl-rt intel-cmplr-lib-rt 2>/dev/null ||
        "$python" -m pip install --quiet intel-opencl-rt intel-cmplr-lib-rt
}

as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
        sudo -n "$@"
    else
        fail "a Debian package is missing and only root can install it: $*"
    fi
}

need_oclgrind() {
    command -v oclgrind >/dev/null && return
    as_root apt-get update -qq
    as_root apt-get install -y -qq oclgrind ||
        fail "oclgrind could not be installed; it is a package of Debian and Ubuntu"
}

# need_package PACKAGE: a Debian package without what it recommends.
need_package() {
    dpkg-query -W -f '${Status}' "$1" 2>/dev/null | grep -q "ok installed" && return
    as_root apt-get update -qq
    as_root apt-get install -y -qq --no-install-recommends "$1" ||
        fail "$1 could not be installed; it is a package of Debian and Ubuntu"
}

need_vkfft() {
    "$python" -c "import pyvkfft.opencl" 2>/dev/null && return
    as_root apt-get update -qq
    as_root apt-get install -y -qq opencl-headers ocl-icd-opencl-dev ||
        fail "OpenCL headers and loader could not be installed; VkFFT is built with them"
    VKFFT_BACKEND=opencl "$python" -m pip install --quiet pyvkfft
}

# Run a command under Oclgrind; its stderr goes to $log.
simulate() { oclgrind --data-races "$@" 2>"$log"; }

reports() { grep -cE '^\s*Kernel: ' "$log" || true; }

# planted FAULT MESSAGE: the fault is reported, and in these words.
planted() {
    simulate "$python" tests/oclgrind/planted.py "$1" || { cat "$log" >&2; fail "planted.py $1 did not run"; }
    grep -q "$2" "$log" || fail "Oclgrind missed the planted fault '$1'"
    [ "$(reports)" -gt 0 ] || fail "the report of the planted fault '$1' was not counted"
    echo "planted fault '$1': $(reports) report(s)"
}

run_install() {
    need_intel
    need_oclgrind
    need_vkfft
}

run_pocl() { "$python" -m pytest -n auto --dist loadfile --device pocl -q; }

run_vkfft() {
    need_vkfft
    "$python" -m pytest tests/compute/test_routes.py --device pocl -q
}

# quick_tests DEVICE TESTS...
quick_tests() {
    "$python" -m pytest -n auto --dist loadfile --device "$1" --device-tests-only \
        -m "not thorough and not nightly" -q "${@:2}"
}

# on_intel TESTS...
on_intel() {
    need_intel
    quick_tests intel "$@"
}

run_intel() { on_intel tests/kernels tests/compute; }

run_intel-both() { on_intel tests/kernels --mapping both; }

run_intel-towers() { on_intel tests/wave tests/lightfield tests/cameras; }

# on_packaged DEVICE PACKAGE LIBRARY TESTS...: the driver of a Debian package, by its library's name.
on_packaged() (
    need_package "$2"
    library=$(ldconfig -p | awk -v name="$3" '$1 == name { print $NF; exit }')
    [ -n "$library" ] || fail "$2 is installed, but the loader does not know $3"
    OCL_ICD_VENDORS=$(mktemp -d)
    trap 'rm -rf "$OCL_ICD_VENDORS"' EXIT
    export OCL_ICD_VENDORS
    echo "$library" >"$OCL_ICD_VENDORS/driver.icd"
    quick_tests "$1" "${@:4}"
)

run_rusticl() {
    RUSTICL_ENABLE=llvmpipe \
        on_packaged rusticl mesa-opencl-icd libRusticlOpenCL.so.1 tests/kernels tests/compute
}

run_debian-pocl() { on_packaged debian pocl-opencl-icd libpocl.so.2 tests/kernels tests/compute; }

run_oclgrind-both() { run_oclgrind both; }

run_oclgrind() {
    need_oclgrind
    log=$(mktemp)
    trap 'rm -f "$log" "$log".[0-9]*' EXIT
    planted race "data race at global memory"
    planted bounds "Invalid read of size 4 at global memory"
    simulate "$python" tests/oclgrind/planted.py clean
    [ "$(reports)" -eq 0 ] || fail "Oclgrind reports a kernel without fault"

    # A process simulates on one core: two at a time, each with some of the files and its own log.
    local files=(tests/kernels/test_*.py) parts=6 part status=0 reported=0
    for ((part = 0; part < parts; ++part)); do
        local some=()
        for ((n = part; n < ${#files[@]}; n += parts)); do some+=("${files[n]}"); done
        local mapping=both
        if [ "${1:-one}" != both ]; then
            if ((part % 2)); then mapping=sample; else mapping=row; fi
        fi
        [ "$part" -lt 2 ] || wait -n
        (
            log=$log.$part code=0
            simulate "$python" -m pytest "${some[@]}" --device oclgrind -q --capture=sys \
                --mapping "$mapping" -m "not thorough and not nightly" \
                -k "not uint16 and not float16 and not -double]" || code=$?
            echo "$code" >"$log.code"
        ) &
    done
    wait
    for ((part = 0; part < parts; ++part)); do
        reported=$((reported + $(log=$log.$part; reports)))
        [ "$(cat "$log.$part.code")" = 0 ] || status=1
    done
    echo "oclgrind: $reported report(s) over tests/kernels"
    if [ "$status" -ne 0 ] || [ "$reported" -ne 0 ]; then
        head -n 60 "$log".[0-9] >&2
        fail "tests/kernels under Oclgrind: pytest ended with $status, $reported report(s)"
    fi
}

python=${1:-python}
[ $# -gt 0 ] && shift
[ "${*:-all}" != all ] || set -- pocl vkfft intel intel-both intel-towers oclgrind-both rusticl debian-pocl
for mode in "$@"; do
    case $mode in
    install | pocl | vkfft | intel | intel-both | intel-towers | oclgrind | oclgrind-both | rusticl | debian-pocl)
        "run_$mode" ;;
    *) fail "unknown mode '$mode': install, pocl, vkfft, intel, intel-both, intel-towers, oclgrind, oclgrind-both, rusticl, debian-pocl or all" ;;
    esac
done
