"""The remedy for CPUs that PoCL's compiler takes for others, with the fault put in on purpose.

Whatever builds a kernel here runs in a process of its own with fresh caches, because a wrong CPU
name aborts the process.
"""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pytest
from forcing import caches_in, forced_environment

from clplen.compute.drivers import builtin_functions, environment, pocl, pocl_trial
from clplen.errors import DeviceError

if not sys.platform.startswith("linux"):
    pytest.skip("PoCL's wheel exists for Linux only", allow_module_level=True)

# Names that LLVM 14 gives to CPUs: AMD's families 23 to 25 and 21, Intel's since 2013.
NAMES = ["generic"]
MORE = ["znver3", "sapphirerapids", "x86-64", "no-such-cpu"]
ALL = ["alderlake", "skylake-avx512", "znver1", "bdver4", "haswell", "icelake-server", "nehalem"]
FITTING = pocl.names_to_try("generic", pocl.cpu_info().get("flags", ""))[0]

OPEN = """
import sys
import pyopencl as cl
from clplen.compute.drivers import pocl
from clplen.errors import DeviceError
platforms = [p for p in cl.get_platforms() if p.name == pocl.PLATFORM]
device = next(d for p in platforms for d in p.get_devices() if pocl.written_name(d))
try:
    print("said", pocl.ensure_usable(device))
except DeviceError as error:
    print("refused", error)
    sys.exit(3)
print("named", pocl.written_name(device))
"""
# After the remedy: a kernel of one's own with 16-wide built-ins, x -> exp(x) / (1 + x * x).
RUN = """
import numpy as np
context = cl.Context([device])
queue = cl.CommandQueue(context)
x = np.linspace(-1.5, 2.0, 16, dtype=np.float32)
source = "kernel void f(global float16 *x) { x[0] = exp(x[0]) / fma(x[0], x[0], (float16)1.0f); }"
kernel = cl.Program(context, source).build(cache_dir=False).f
memory = cl.Buffer(context, cl.mem_flags.COPY_HOST_PTR, hostbuf=x)
kernel(queue, (1,), None, memory)
y = np.empty_like(x)
cl.enqueue_copy(queue, y, memory)
twin = np.exp(x.astype(float)) / (1.0 + x.astype(float) ** 2)
assert np.abs(y / twin - 1.0).max() < 1e-6, y / twin
print("ran")
"""
NO_CHILD = "import sys; sys.executable = ''\n"


def renamable() -> list[cl.Device]:
    """PoCL's devices whose CPU name can be replaced; PoCL 3.1 and newer need none."""
    try:
        platforms = cl.get_platforms()
    except cl.LogicError:
        return []
    here = [d for p in platforms if p.name == pocl.PLATFORM for d in p.get_devices()]
    return [device for device in here if pocl.written_name(device)]


needs_pocl = pytest.mark.skipif(not renamable(), reason="no PoCL whose CPU name can be replaced")


def python(code: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=100
    )


def verdicts(folder: Path) -> list[str]:
    return [json.loads(p.read_text())["name"] for p in folder.glob("clplen/pocl-*.json")]


@needs_pocl
@pytest.mark.parametrize(
    "name",
    [
        *NAMES,
        *(pytest.param(name, marks=pytest.mark.thorough) for name in MORE),
        *(pytest.param(name, marks=pytest.mark.nightly) for name in ALL),
    ],
)
def test_whatever_the_compiler_takes_the_cpu_for_kernels_run(tmp_path: Path, name: str) -> None:
    environment = forced_environment(tmp_path, name)
    done = python(OPEN + RUN, environment)
    assert done.stdout.endswith("ran\n"), done.stdout + done.stderr
    assert done.stderr == ""
    (taken,) = verdicts(tmp_path)
    assert f"named {taken}\n" in done.stdout
    assert pocl._register_width(taken) == pocl._register_width(FITTING)
    replaced = f"mistakes for {name!r}; clplen set the CPU name {taken!r}" in done.stdout
    assert replaced != (name == taken)
    again = python(NO_CHILD + OPEN, environment)
    assert again.stdout == done.stdout.removesuffix("ran\n")


@needs_pocl
def test_without_the_remedy_the_error_says_what_to_install(tmp_path: Path) -> None:
    done = python(OPEN, forced_environment(tmp_path, CLPLEN_POCL_CPU="off"))
    assert done.returncode == 3, done.stderr
    assert "does not fit this CPU, which it mistakes for 'generic'" in done.stdout
    assert "CLPLEN_POCL_CPU=off" in done.stdout
    assert "apt install pocl-opencl-icd" in done.stdout
    assert "pip install intel-opencl-rt intel-cmplr-lib-rt" in done.stdout


@needs_pocl
def test_where_no_child_can_be_started_a_name_that_fits_is_trusted(tmp_path: Path) -> None:
    done = python(NO_CHILD + OPEN + RUN, forced_environment(tmp_path))
    assert done.stdout.endswith(f"named {FITTING}\nran\n"), done.stdout + done.stderr
    assert verdicts(tmp_path) == []


@needs_pocl
def test_a_name_that_fails_is_refused_and_the_process_lives(tmp_path: Path) -> None:
    environment = forced_environment(tmp_path, CLPLEN_POCL_CPU="no-such-cpu")
    done = python(OPEN, environment)
    assert done.returncode == 3, done.stdout + done.stderr
    assert "fails under the CPU name 'no-such-cpu'" in done.stdout
    assert verdicts(tmp_path) == [""]
    again = python(NO_CHILD + OPEN, environment)
    (file,) = tmp_path.glob("clplen/pocl-*.json")
    assert f"remove {file} to try again" in again.stdout


@needs_pocl
def test_wrong_values_are_a_bad_verdict(tmp_path: Path) -> None:
    source = tmp_path / "builtins.cl"
    text = BUILTINS.read_text()
    source.write_text(text.replace("KEEP(floor(b))", "KEEP(ceil(b))", 1))
    assert source.read_text() != text
    version = renamable()[0].platform.version
    command = [sys.executable, "-m", pocl_trial.__name__, version, FITTING, str(source)]
    environment = caches_in(tmp_path)
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == pocl_trial.UNFIT, done.stderr
    assert done.stderr.endswith("Wrong values: floor; floor of double.\n")


# What is a verdict

DYING = """
import os, signal, sys
print("ready" * {ready}, flush=True)
print("Final linking failed.", file=sys.stderr, flush=True)
if {status} > 0 and {status} != signal.SIGKILL:  # which `nohup` or a shell may have ignored
    signal.signal({status}, signal.SIG_DFL)
os.kill(os.getpid(), {status}) if {status} > 0 else os._exit(-{status})
"""


@pytest.fixture
def dying(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., bool]:
    """A trial that ends in a chosen way: by a signal, or by an exit status below 0."""
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(pocl_trial, "__name__", "dying_trial")
    monkeypatch.syspath_prepend(str(tmp_path))

    def trial(status: int, *, ready: bool = True) -> bool:
        program = DYING.format(status=int(status), ready=int(ready))
        (tmp_path / "dying_trial.py").write_text(program)
        return pocl._survives("version", "some-cpu")

    return trial


@pytest.mark.parametrize("status", [signal.SIGXCPU, signal.SIGSEGV, -pocl_trial.UNFIT])
def test_faults_of_compiled_code_are_verdicts(dying: Callable[..., bool], status: int) -> None:
    assert dying(status) is False


@pytest.mark.parametrize("status", [signal.SIGKILL, signal.SIGTERM])
def test_signals_of_others_are_no_verdict(dying: Callable[..., bool], status: int) -> None:
    with pytest.raises(OSError, match=f"killed by signal {int(status)}"):
        dying(status)


@pytest.mark.parametrize("status", [signal.SIGSEGV, -1])
def test_what_also_ends_a_kernel_without_built_in_functions_is_no_verdict(
    dying: Callable[..., bool], status: int
) -> None:
    with pytest.raises(DeviceError, match=r"\(Final linking failed\.\): provide memory"):
        dying(status, ready=False)


def test_a_fault_on_a_full_disk_is_no_verdict(
    dying: Callable[..., bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(environment, "find_obstacle", lambda *_: "No space left on device")
    with pytest.raises(DeviceError, match="No space left"):
        dying(signal.SIGABRT)


def test_a_trial_that_does_not_end_is_no_verdict(
    dying: Callable[..., bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pocl, "TRIAL_SECONDS", 0.01)
    with pytest.raises(OSError, match="did not end"):
        dying(0)


def test_a_compiler_that_never_ends_is_ended_by_sigxcpu() -> None:
    code = """
from clplen.compute.drivers import pocl_trial
pocl_trial.SECONDS = 1
def compile_for_ever():
    while True:
        pass
pocl_trial.cl.get_platforms = compile_for_ever
pocl_trial.main("", "", "")
"""
    done = python(code, dict(os.environ) | {"PYTHONPATH": os.pathsep.join(sys.path)})
    assert done.returncode == -signal.SIGXCPU, done.stderr


KILLED = OSError("the trial was killed by signal 9")


@pytest.mark.parametrize(
    ("answers", "name", "kept"),
    [
        ({"haswell": False, "sandybridge": True}, "sandybridge", ["sandybridge"]),
        ({"haswell": False, "sandybridge": False}, "", [""]),
        ({"haswell": KILLED, "sandybridge": True}, "sandybridge", []),
        ({"haswell": KILLED, "sandybridge": False}, "haswell", []),
    ],
)
def test_only_whole_verdicts_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answers: dict[str, bool | OSError], name: str,
    kept: list[str],
) -> None:  # fmt: skip
    def survives(version: str, name: str) -> bool:
        if isinstance(answers[name], OSError):
            raise answers[name]
        return answers[name]

    monkeypatch.setattr(pocl, "_survives", survives)
    device = SimpleNamespace(platform=SimpleNamespace(version="OpenCL 3.0 PoCL 3.0"))
    path = tmp_path / "clplen" / "pocl-1.json"
    assert pocl._test_names(device, list(answers), path) == name
    assert verdicts(tmp_path) == kept
    assert pocl._read_verdict(path, list(answers)) == (kept[0] if kept else None)


def test_a_damaged_verdict_is_no_verdict(tmp_path: Path) -> None:
    path = tmp_path / "pocl-1.json"
    for damage in ("", "[]", "[" * 100_000, '{"name": 5}', '{"name": "knl"}', "\0" * 50):
        path.write_text(damage)
        assert pocl._read_verdict(path, ["haswell"]) is None


INTERRUPTED = """
import ctypes, os, signal, threading
from clplen.compute.drivers.program import build_program
from clplen.compute.drivers.selection import find_devices, select
signal.signal(signal.SIGINT, lambda *_: None)
((_, device),) = select(find_devices(), "pocl")[:1]
context = cl.Context([device])
building = True
def interrupt():
    while building:
        os.kill(os.getpid(), signal.SIGINT)
        threading.Event().wait(0.002)
thread = threading.Thread(target=interrupt)
thread.start()
try:
    for number in range(4):
        build_program(context, "finite.cl", {"ROWS": True, f"NUMBER_{number}": number})
finally:
    building = False
    thread.join()
print("ran")
"""


@needs_pocl
def test_signals_do_not_break_a_build(tmp_path: Path) -> None:
    done = python("import pyopencl as cl" + INTERRUPTED, caches_in(tmp_path))
    assert done.stdout == "ran\n", done.stderr


def test_other_devices_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pocl_trial, "find_name", lambda address: pytest.fail("it was looked into"))
    for name, version in (
        ("NVIDIA CUDA", "3.0"),
        (pocl.PLATFORM, "3.1"),
        (pocl.PLATFORM, "4.0"),
        (pocl.PLATFORM, "10.0"),
    ):
        device = SimpleNamespace(platform=SimpleNamespace(name=name), driver_version=version)
        assert pocl.ensure_usable.__wrapped__(device) == ""
    monkeypatch.setattr(pocl.platform, "machine", lambda: "aarch64")
    device = SimpleNamespace(platform=SimpleNamespace(name=pocl.PLATFORM), driver_version="3.0-rc2")
    assert pocl.ensure_usable.__wrapped__(device) == ""


# The order of trials

SSE41 = "fpu cx16 ssse3 sse4_1 popcnt"
AVX = f"{SSE41} avx"
HASWELL = f"{AVX} avx2 fma bmi1 bmi2 f16c abm"


def test_the_library_is_that_of_pocl() -> None:
    for flags, library in (
        (f"{HASWELL} avx512f", "avx512"),
        (HASWELL, "avx2"),
        (HASWELL.replace(" abm", ""), "avx_f16c"),
        (f"{AVX} f16c xop fma4", "avx_fma4"),
        (AVX, "avx"),
        (SSE41, "sse41"),
        ("fpu cx16 ssse3", "ssse3"),
        ("", "sse2"),
    ):
        assert pocl.library(flags) == library


def test_names_are_tried_in_this_order() -> None:
    for present, flags, names in (
        ("znver3", f"{HASWELL} avx512f", ["skylake-avx512", "znver3"]),  # Zen 4
        ("generic", f"{HASWELL} avx512f", ["skylake-avx512", "generic"]),  # Zen 5
        ("rocketlake", f"{HASWELL} avx512f", ["rocketlake", "skylake-avx512"]),
        ("sapphirerapids", f"{HASWELL} avx512f", ["sapphirerapids", "skylake-avx512"]),
        ("skylake-avx512", f"{HASWELL} avx512f", ["skylake-avx512"]),
        ("znver3", HASWELL, ["znver3", "haswell", "sandybridge"]),
        ("icelake-server", HASWELL, ["haswell", "sandybridge", "icelake-server"]),  # masked flags
        ("skylake", SSE41, ["x86-64", "skylake"]),  # a Pentium
        ("arrowlake", HASWELL, ["arrowlake", "haswell", "sandybridge"]),  # of a later LLVM
    ):
        assert pocl.names_to_try(present, flags) == names
        assert pocl.names_to_try(present, flags, "off") == [present]
        assert pocl.names_to_try(present, flags, "knl") == ["knl"]


# What is tried

KERNELS = Path(__file__).parents[2] / "kernels"
BUILTINS = KERNELS / "common" / "builtins.cl"
COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
# Built-in functions of OpenCL C 1.2 (6.12): work-items and barriers are part of every kernel.
BUILT_IN = re.compile(
    r"\b(a?(?:sin|cos|tan)(?:h|pi)?|atan2(?:pi)?|sincos|a(?:sin|cos|tan)h|cbrt|ceil|copysign|erfc?"
    r"|exp(?:2|10|m1)?|fabs|fdim|floor|fma|fmax|fmin|fmod|fract|frexp|hypot|ilogb|ldexp|lgamma(?:_r)?"
    r"|log(?:2|10|1p|b)?|mad|maxmag|minmag|modf|nan|nextafter|pown?|powr|remainder|remquo|rint|rootn"
    r"|round|rsqrt|sqrt|tgamma|trunc|native_\w+|half_\w+|abs(?:_diff)?|add_sat|r?hadd|clamp|clz"
    r"|mad_hi|mad_sat|max|min|mul_hi|rotate|sub_sat|upsample|popcount|mad24|mul24|degrees|mix"
    r"|radians|step|smoothstep|sign|cross|dot|distance|length|normalize|fast_\w+|is(?:equal|notequal"
    r"|greater|greaterequal|less|lessequal|lessgreater|finite|inf|nan|normal|ordered|unordered)"
    r"|signbit|any|all|bitselect|select|convert_\w+|as_\w+|vload_half|vload_half\d*|vloada_half\d*"
    r"|vstore_half\w*|vstorea_half\w*|shuffle2?|atomic_\w+|atom_\w+|async_\w+|printf)\s*\("
)
JOINED = re.compile(r"\bJOIN\((convert_float|vload_half),")
# Types of one width, which a compiler treats alike: as_int of a float, convert_int of a float.
CLASS = {"as_uint": "as_uint", "as_float": "as_float"}


def called(source: str) -> set[str]:
    """Built-in functions that a source calls, as `JOIN(convert_float, LANES)` for every width."""
    text = COMMENT.sub(" ", source)
    own = set(re.findall(r"\b(\w+)\s*\([^()]*\)\s*\{", text))
    names = {name for name in BUILT_IN.findall(text) if name not in own}
    for stem in JOINED.findall(text):
        names |= {f"{stem}{width}" for width in (4, 8, 16)}
    return names


def test_every_built_in_function_of_the_kernels_is_tried() -> None:
    tried = called(BUILTINS.read_text()) | set(
        re.findall(r"\b(?:convert_\w+|vload_half\d*)\b", BUILTINS.read_text())
    )
    others = {f.name: called(f.read_text()) for f in KERNELS.rglob("*.cl") if f.stem != "builtins"}
    missing = {name: sorted(names - tried) for name, names in others.items() if names - tried}
    assert not missing
    assert len(set().union(*others.values())) > 25, "the pattern finds what is called"


def test_each_value_that_is_wrong_is_named() -> None:
    expected = builtin_functions.expected(double=True)
    values = np.array(list(expected.values()), np.float32)
    assert builtin_functions.wrong(values, double=True) == []
    for number, name in enumerate(expected):
        for damaged in (values[number, 5] + 1e-3, np.nan):
            bad = values.copy()
            bad[number, 5] = damaged
            assert builtin_functions.wrong(bad, double=True) == [name]


# The place of the name


def heap_string(text: bytes) -> int:
    strdup = ctypes.CDLL(None).strdup
    strdup.restype = ctypes.c_void_p
    return strdup(text)


TRIPLE = heap_string(b"x86_64-unknown-linux-gnu")


class Memory:
    """A page that looks like a device object: two strings behind one another at a word."""

    def __init__(self, name: int, *, triple: int = TRIPLE, word: int = 77) -> None:
        self.page = mmap.mmap(-1, 4 * mmap.PAGESIZE)
        self.address = ctypes.addressof(ctypes.c_char.from_buffer(self.page))
        ctypes.c_uint64.from_address(self.address + 8 * word).value = triple
        ctypes.c_uint64.from_address(self.address + 8 * (word + 1)).value = name

    def find(self) -> str | None:
        pointer = pocl_trial.find_name(self.address)
        return None if pointer is None else pocl_trial.read_name(pointer)


def test_the_name_stands_behind_the_triple() -> None:
    memory = Memory(heap_string(b"skylake-avx512"))
    assert memory.find() == "skylake-avx512"
    pocl_trial.write_name(pocl_trial.find_name(memory.address), "haswell")
    assert memory.find() == "haswell"


def test_what_is_no_name_is_left_alone() -> None:
    for text in (b"", b"a", b"Intel(R) Xeon", b"a" * 63, b"\xff\xfe\xfd"):
        assert Memory(heap_string(text)).find() is None
    for triple in (b"aarch64-unknown-linux-gnu", b"x86_64", b"OpenCL 3.0 PoCL"):
        assert Memory(heap_string(b"generic"), triple=heap_string(triple)).find() is None


def test_the_search_stays_within_a_kilobyte() -> None:
    target = heap_string(b"generic")
    assert Memory(target, word=126).find() == "generic"
    assert Memory(target, word=127).find() is None


def test_memory_that_cannot_be_written_is_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "name"
    file.write_bytes(b"generic\0" + bytes(mmap.PAGESIZE))
    libc = ctypes.CDLL(None)
    libc.mmap.restype = ctypes.c_void_p
    libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t] + [ctypes.c_int] * 3 + [ctypes.c_long]
    handle = os.open(file, os.O_RDONLY)
    address = libc.mmap(None, mmap.PAGESIZE, mmap.PROT_READ, mmap.MAP_PRIVATE, handle, 0)
    os.close(handle)
    assert ctypes.string_at(address) == b"generic"
    assert Memory(address).find() is None


def test_a_device_object_at_the_end_of_its_mapping_is_read_to_the_end_only() -> None:
    code = """
import ctypes, mmap
from clplen.compute.drivers import pocl_trial
page = mmap.PAGESIZE
libc = ctypes.CDLL(None)
libc.mmap.restype = ctypes.c_void_p
libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t] + [ctypes.c_int] * 3 + [ctypes.c_long]
libc.munmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t]
kind = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS
base = libc.mmap(None, 3 * page, mmap.PROT_READ | mmap.PROT_WRITE, kind, -1, 0)
libc.munmap(base + page, 2 * page)  # nothing is mapped behind the first page
last = ctypes.c_uint64.from_address(base + page - 8)
last.value = base + page - 4  # a string that would run over the end
print(pocl_trial.find_name(base + page - 64))
"""
    done = python(code, dict(os.environ) | {"PYTHONPATH": os.pathsep.join(sys.path)})
    assert done.stdout == "None\n", done.stderr
