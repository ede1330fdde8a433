"""Imports go down from room to room; five calls are followed in few files; importing is quick."""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "clplen"
# Storeys from the ground up: modules and folders of the package. Those of one line never import
# each other. `clplen` is the list of public names on top: only what stands above it imports it.
# An import counts wherever it stands, in functions and under TYPE_CHECKING too.
STOREYS: tuple[set[str], ...] = (
    {"errors", "interrupts", "types", "units", "reprs"},
    {"checks", "files", "hdf5_safety"},
    {"settings"},
    {"outputs", "progress", "results"},
    {"compute"},
    {"wave", "lightfield"},
    {"cameras"},
    {"clplen"},
    {"analysis", "io"},
    {"microscopy"},
    {"plot", "config", "torch", "jax"},
    {"viewer"},
    {"batch", "demo"},
    {"bench"},
    {"selftest"},
    {"cli"},
    {"__main__"},
)
# Rooms of a storey, from the ground up; what lies in the storey's own folder stands above them.
ROOMS: dict[str, tuple[set[str], ...]] = {
    "compute": ({"drivers"}, {"fft"}),
    "wave": ({"field"}, {"elements", "spectrum", "propagation"}, {"systems"}, {"coherence"}),
    "lightfield": (
        {"arrays"},
        {"raw"},
        {"model"},
        {"calibration", "refocusing", "focused", "matching", "metric"},
        {"depth"},
        {"streaming", "axis_check"},
    ),
    "cameras": ({"scenes"}, {"optics"}, {"exposure"}),
    "microscopy": (
        {"model", "objects"},
        {"fourier"},
        {"reconstruction"},
        {"frames", "series"},
        {"pupil"},
    ),
    "analysis": ({"point"}, {"cameras"}, {"report"}),
    "io": ({"formats"}, {"store"}, {"raw"}, {"lightfields"}, {"results", "page", "displays"}),
    "batch": ({"jobs"}, {"work"}, {"running"}),
    "cli": ({"shared"}, {"microscopy", "displays"}),
}
HEIGHT = {unit: height for height, units in enumerate(STOREYS) for unit in units}
TOPICS = ("analysis", "batch", "cameras", "io", "lightfield", "microscopy", "plot", "wave")
BRIDGES = ("jax", "torch")  # topics that need another library, of the same name
SCRIPTS = (*TOPICS, "bench")  # what scripts of benchmarks may name, too
ENTRIES = ("cli", "config", "demo", "selftest")  # folders whose names other storeys take
LARGEST_FOLDER = 17  # modules
LEAST = 30  # lines
SHORT = {"__main__", "preload", "types"}  # programs and names of types
LONGEST_WAY = 10  # files
# Who may import what is not in the Python standard library.
ANYWHERE = {"numpy", "scipy", "pyopencl", "lazy_loader"}
GUESTS = {
    "compute": {"ducc0", "pyvkfft"},
    "hdf5_safety": {"h5py"},
    "lightfield": {"cv2"},
    "cameras": {"optiland"},
    "microscopy": {"h5py"},
    "io": {"PIL", "h5py", "imageio", "imageio_ffmpeg", "tifffile", "zarr"},
    "plot": {"matplotlib"},
    "progress": {"tqdm"},
    "torch": {"torch"},
    "jax": {"jax"},
    "bench": {"ducc0"},
    "config": {"pydantic", "tomli"},
    "viewer": {"anywidget", "traitlets"},
    "batch": {"cryptography", "dask", "distributed", "filelock", "pydantic"},
    "cli": {"click", "tqdm"},
}


def module_name(file: Path, package: Path) -> str:
    """The dotted name of a file of the package."""
    parts = file.relative_to(package.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def unit_of(module: str) -> str:
    """The unit of the storeys that a module belongs to."""
    return module.split(".")[1] if "." in module else module


def room_height(module: str) -> int:
    """How high a module's room stands in its storey; above all rooms if it lies in none."""
    rooms = ROOMS.get(unit_of(module), ())
    room = module.split(".")[2] if module.count(".") > 1 else ""
    return next((height for height, names in enumerate(rooms) if room in names), len(rooms))


def room_of(module: str) -> tuple[str, str]:
    """Unit and room; no room of what lies in the unit's own folder."""
    unit = unit_of(module)
    inside = room_height(module) < len(ROOMS.get(unit, ()))
    return unit, module.split(".")[2] if inside else ""


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """All statements in a node, without their expressions."""
    for field in ("body", "orelse", "finalbody", "handlers", "cases"):
        for inner in getattr(node, field, []):
            yield inner
            yield from statements(inner)


@cache
def parse(source: str) -> ast.Module:
    """Parse the text of a module, each once."""
    return ast.parse(source)


def imports(module: str, source: str, modules: set[str]) -> Iterator[tuple[str, int]]:
    """(module, line) of everything that a module imports, wherever the import stands."""
    for node in statements(parse(source)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}:{node.lineno}: imports are absolute here"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield (full if full in modules else str(node.module), node.lineno)


def read(package: Path) -> dict[str, list[tuple[str, int]]]:
    """What each module of a package imports."""
    sources = {module_name(f, package): f.read_text() for f in sorted(package.rglob("*.py"))}
    return {
        module: list(imports(module, source, set(sources))) for module, source in sources.items()
    }


def wrong_arrows(graph: dict[str, list[tuple[str, int]]]) -> list[str]:
    """Imports inside the package that do not go down the storeys and rooms."""
    wrong = []
    for module, targets in graph.items():
        for target, line in targets:
            if target.split(".")[0] != "clplen":
                continue
            above, below = unit_of(module), unit_of(target)
            if {above, below} - HEIGHT.keys():
                goes_down = False
            elif above != below:
                goes_down = HEIGHT[below] < HEIGHT[above]
            else:
                goes_down = room_of(module) == room_of(target) and above != "clplen"
                goes_down |= room_height(target) < room_height(module)
            if not goes_down:
                wrong.append(f"{module}:{line} imports {target}")
    return wrong


def wrong_guests(graph: dict[str, list[tuple[str, int]]]) -> list[str]:
    """Imports of libraries by rooms that have no use for them."""
    wrong = []
    for module, targets in graph.items():
        storey = module.split(".")[1] if "." in module else module
        welcome = ANYWHERE | GUESTS.get(storey, set()) | sys.stdlib_module_names
        for target, line in targets:
            if target.split(".")[0] not in welcome | {"clplen"}:
                wrong.append(f"{module}:{line} imports {target}")
    return wrong


def circle(graph: dict[str, list[tuple[str, int]]]) -> list[str]:
    """Modules that import each other in a ring, empty if there is none."""
    inside = {m: [t for t, _ in targets if t in graph] for m, targets in graph.items()}
    try:
        TopologicalSorter(inside).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


@pytest.fixture(scope="module")
def graph() -> dict[str, list[tuple[str, int]]]:
    """What each module of clplen imports."""
    return read(PACKAGE)


def test_every_folder_has_its_place() -> None:
    units = {f.relative_to(PACKAGE).parts[0].removesuffix(".py") for f in PACKAGE.rglob("*.py")}
    assert units - {"__init__"} == HEIGHT.keys() - {"clplen"}
    for unit in HEIGHT:
        folders = {f.parent.name for f in PACKAGE.glob(f"{unit}/*/*.py")}
        assert folders == set().union(*ROOMS.get(unit, ()))


def test_imports_go_down(graph: dict[str, list[tuple[str, int]]]) -> None:
    assert wrong_arrows(graph) == []


def test_libraries_stay_where_they_are_needed(graph: dict[str, list[tuple[str, int]]]) -> None:
    assert wrong_guests(graph) == []


def test_no_imports_in_a_circle(graph: dict[str, list[tuple[str, int]]]) -> None:
    assert circle(graph) == []


def faults_of_form() -> Iterator[str]:
    """Modules and folders that do not have the form of all others."""
    folders = Counter(f.parent for f in PACKAGE.rglob("*.py") if f.name != "__init__.py")
    for folder, count in folders.items():
        if count > LARGEST_FOLDER and folder != PACKAGE:
            yield f"{folder} holds {count} modules"
    for file in PACKAGE.rglob("*.py"):
        text, name = file.read_text(), str(file.relative_to(ROOT))
        tree = parse(text)
        if file.name == "__init__.py":
            is_list = file.parent == PACKAGE or file.parent.name in SCRIPTS + ENTRIES + BRIDGES
            if not ast.get_docstring(tree):
                yield f"{name} says nothing"
            if len(tree.body) > 1 and not is_list:
                yield f"{name} has code"
        elif file.stem not in SHORT:
            kinds = {type(node) for node in tree.body}
            passed_on = {ast.Expr, ast.Import, ast.ImportFrom, ast.Assign, ast.If}
            if ast.ImportFrom in kinds <= passed_on:
                yield f"{name} only passes names on"
            if len(text.splitlines()) < LEAST:
                yield f"{name} is very short"


def test_modules_and_folders_have_their_form() -> None:
    assert list(faults_of_form()) == []


def public_names(topic: str) -> set[str]:
    """``__all__`` of the package or of a topic."""
    return set(importlib.import_module(topic).__all__)


def stub_names(topic: str) -> set[str]:
    """The names of a topic whose library may not be installed, as its stub lists them."""
    tree = ast.parse((PACKAGE / topic / "__init__.pyi").read_text())
    return {a.name for n in tree.body if isinstance(n, ast.ImportFrom) for a in n.names}


@cache
def public_by_module(topics: tuple[str, ...]) -> dict[str, set[str]]:
    """Public names of the top, of topics and of bridges."""
    public = {f"clplen.{topic}": public_names(f"clplen.{topic}") for topic in topics}
    public |= {f"clplen.{bridge}": stub_names(bridge) for bridge in BRIDGES}
    public["clplen"] = {*public_names("clplen"), *topics, *BRIDGES, "demo"}
    return public | {"clplen.demo": public_names("clplen.demo")}


def deep_imports(text: str, topics: tuple[str, ...] = TOPICS) -> list[str]:
    """Imports of a script that are neither of the top nor of a topic's public names."""
    public = public_by_module(topics)
    deep = []
    for node in ast.walk(parse(text)):
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] == "clplen":
            names = public.get(str(node.module), set())
            deep += [f"{node.module}.{a.name}" for a in node.names if a.name not in names]
        elif isinstance(node, ast.Import):
            of_ours = [a.name for a in node.names if a.name.split(".")[0] == "clplen"]
            deep += [name for name in of_ours if name not in public]
    return deep


def test_scripts_import_public_names() -> None:
    folders = (("examples", TOPICS), ("benchmarks", SCRIPTS))
    files = [(file, topics) for name, topics in folders for file in (ROOT / name).rglob("*.py")]
    deep = {file.name: deep_imports(file.read_text(), topics) for file, topics in files}
    assert {name: names for name, names in deep.items() if names} == {}


def test_pages_import_public_names() -> None:
    deep: dict[str, list[str]] = {}
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        for block in re.findall(r"^```python\n(.*?)^```", page.read_text(), re.M | re.S):
            deep[page.name] = deep.get(page.name, []) + deep_imports(block)
    assert {name: found for name, found in deep.items() if found} == {}


PLANTED = {  # module, its text, and whether the import is wrong
    ("wave/field/grid", "from clplen.errors import ShapeError"): False,
    ("wave/field/grid", "from clplen.wave.field.phase import phasor"): False,
    ("wave/field/grid", "from clplen.wave.elements import lens"): True,
    ("wave/elements/lens", "from clplen.wave.field.grid import Grid"): False,
    ("wave/field/grid", "from clplen.lightfield.raw import decode"): True,
    ("compute/device", "def late():\n    from clplen.wave.field.grid import Grid"): True,
    ("compute/device", "if TYPE_CHECKING:\n  pass\nelse:\n  import clplen.wave.field"): True,
    ("cameras/scenes/points", "from clplen import Device"): True,
    ("io/formats/pfm", "from clplen import Device"): False,
    ("plot/base", "from clplen import batch"): True,
    ("demo", "from clplen import batch"): True,
    ("other", "from clplen import errors"): True,
}


def test_planted_arrows_are_judged() -> None:
    places = {module for module, _ in PLANTED} | {"wave/field/phase", "lightfield/raw/decode"}
    modules = {f"clplen.{name.replace('/', '.')}" for name in places} | {"clplen.batch"}
    modules |= {"clplen.errors"}
    for (name, text), is_wrong in PLANTED.items():
        module = f"clplen.{name.replace('/', '.')}"
        graph = {module: list(imports(module, text, modules))}
        assert bool(wrong_arrows(graph)) == is_wrong, (name, text)


def test_a_planted_guest_and_a_planted_circle_are_found() -> None:
    welcome = {"clplen.io.hdf5": [("h5py", 1)], "clplen.plot": [("matplotlib.cm", 1)]}
    assert wrong_guests(welcome) == []
    assert wrong_guests({"clplen.cli": [("h5py", 3)]}) == ["clplen.cli:3 imports h5py"]
    ring = {"clplen.wave.a": [("clplen.wave.b", 1)], "clplen.wave.b": [("clplen.wave.a", 1)]}
    assert len(circle(ring)) == 3
    assert circle({"clplen.wave.a": [("clplen.wave.b", 1)], "clplen.wave.b": []}) == []


def test_a_planted_deep_import_is_found() -> None:
    assert deep_imports("from clplen import Device\nimport clplen.io\n") == []
    assert deep_imports("from clplen.errors import ShapeError") != []
    assert deep_imports("def late():\n    import clplen.wave.field") != []
    assert deep_imports("from clplen import no_such_name") != []


WAY = re.compile(r"^\d+\. `(clplen/[\w/]+\.py)` `(\w+(?:\.\w+)?)`", re.M)
WAYS = ("propagate", "expose", "read_lightfield", "focal_stack", "deconvolve")


def ways() -> dict[str, list[tuple[str, str]]]:
    """(file, function) of each stop of the ways that docs/architecture.md lists."""
    text = (ROOT / "docs/architecture.md").read_text()
    parts = re.split(r"^### `(\w+)`.*$", text, flags=re.M)
    return {name: WAY.findall(part) for name, part in zip(parts[1::2], parts[2::2], strict=True)}


IMPORT = """
import sys
import pyopencl

def touched(*_):
    raise SystemExit("a device was touched")

pyopencl.get_platforms = pyopencl.create_some_context = touched
import clplen
absent = "matplotlib h5py tifffile imageio click tqdm pydantic ducc0 pyvkfft torch jax".split()
print(*(name for name in absent if name in sys.modules))
"""
ALONE = "from time import process_time as t; a = t(); import clplen; print(t() - a)"


def python(code: str) -> list[str]:
    """Lines that a new Python process prints."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.split("\n")


def test_importing_touches_no_device_and_no_optional_library() -> None:
    assert python(IMPORT)[0] == ""


def test_importing_takes_less_than_a_second() -> None:
    # Of processor time, with NumPy, SciPy and pyopencl; the shortest of a few, since others run.
    assert min(float(python(ALONE)[0]) for _ in range(4)) < 1.0
