"""Imports go one way; importing the package touches no device and is quick."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "clplen"
# Units from the ground up; those of one storey never import each other. `clplen` is the list of
# public names: it imports the towers, and only what stands above them imports it.
STOREYS = (
    {"errors", "deprecation", "interrupts", "types"},
    {"checks", "units", "reprs"},
    {"files", "hdf5_heap", "hdf5_links"},
    {"outputs"},
    {"compute"},
    {"wave", "lightfield"},
    {"cameras"},
    {"clplen"},
    {"analysis", "io", "microscopy"},
    {"plot", "config"},
    {"batch", "demo"},
    {"bench"},
    {"selftest"},
    {"cli"},
    {"__main__"},
)
HEIGHT = {unit: height for height, units in enumerate(STOREYS) for unit in units}
# Who may import what is not in the Python standard library.
ANYWHERE = {"numpy", "scipy", "pyopencl"}
GUESTS = {
    "compute": {"ducc0", "pyvkfft"},
    "hdf5_links": {"h5py"},
    "microscopy": {"h5py"},
    "io": {"PIL", "h5py", "imageio", "tifffile", "tqdm", "zarr"},
    "plot": {"matplotlib"},
    "config": {"pydantic", "tomli"},
    "batch": {"cryptography", "dask", "distributed", "filelock", "pydantic"},
    "bench": {"cv2", "ducc0", "numba", "torch"},
    "cli": {"click", "tqdm"},
}


def module_name(file: Path, package: Path) -> str:
    """The dotted name of a file of the package."""
    parts = file.relative_to(package.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def unit_of(module: str) -> str:
    """The unit that a module of the package belongs to."""
    return module.split(".")[1] if "." in module else module


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def run_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Every node that a running program may reach, that is without ``if TYPE_CHECKING:``."""
    yield node
    children = ast.iter_child_nodes(node)
    if is_type_checking(node):
        children = iter(node.orelse)
    for child in children:
        yield from run_nodes(child)


def imports(module: str, source: str, modules: set[str]) -> Iterator[tuple[str, int]]:
    """(module, line) of everything that a module imports, at its top or later."""
    for node in run_nodes(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}:{node.lineno}: imports are absolute here"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield (whole if whole in modules else str(node.module), node.lineno)


def read(package: Path) -> dict[str, list[tuple[str, int]]]:
    """What each module of a package imports."""
    sources = {module_name(f, package): f.read_text() for f in sorted(package.rglob("*.py"))}
    return {
        module: list(imports(module, source, set(sources))) for module, source in sources.items()
    }


def wrong_arrows(graph: dict[str, list[tuple[str, int]]]) -> list[str]:
    """Imports inside the package that do not go down the storeys."""
    wrong = []
    for module, targets in graph.items():
        for target, line in targets:
            above, below = unit_of(module), unit_of(target)
            if target.split(".")[0] != "clplen" or (above == below and above != "clplen"):
                continue
            unknown = {above, below} - HEIGHT.keys()
            if unknown or HEIGHT[below] >= HEIGHT[above]:
                wrong.append(f"{module}:{line} imports {target}")
    return wrong


def wrong_guests(graph: dict[str, list[tuple[str, int]]]) -> list[str]:
    """Imports from outside that this unit has no use for."""
    wrong = []
    for module, targets in graph.items():
        welcome = ANYWHERE | GUESTS.get(unit_of(module), set()) | sys.stdlib_module_names
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


def test_every_unit_has_its_storey(graph: dict[str, list[tuple[str, int]]]) -> None:
    assert {unit_of(module) for module in graph} <= HEIGHT.keys()


def test_imports_go_down(graph: dict[str, list[tuple[str, int]]]) -> None:
    assert wrong_arrows(graph) == []


def test_libraries_stay_where_they_are_needed(graph: dict[str, list[tuple[str, int]]]) -> None:
    assert wrong_guests(graph) == []


def test_no_imports_in_a_circle(graph: dict[str, list[tuple[str, int]]]) -> None:
    assert circle(graph) == []


@pytest.mark.parametrize(
    ("module", "text", "is_wrong"),
    [
        ("wave/field", "from clplen.errors import ShapeError", False),
        ("wave/field", "from clplen.wave.phase import phasor", False),
        ("wave/field", "from clplen.lightfield import raw", True),
        ("lightfield/raw", "from clplen import wave", True),
        ("lightfield/raw", "import clplen.cameras.scene", True),
        ("compute/device", "def late():\n    from clplen.wave.field import Grid", True),
        ("compute/device", "if TYPE_CHECKING:\n    from clplen.wave.field import Grid", False),
        ("compute/device", "if TYPE_CHECKING:\n  pass\nelse:\n  import clplen.wave.field", True),
        ("cameras/scene", "from clplen import Device", True),
        ("io/pfm", "from clplen import Device", False),
        ("io/pfm", "from clplen import plot", True),
        ("plot", "from clplen.io import pfm", False),
        ("plot", "from clplen import batch", True),
        ("demo", "from clplen import batch", True),
        ("cli", "from clplen import demo, config", False),
        ("demo", "from clplen import cli", True),
        ("errors", "from clplen.compute import device", True),
        ("other", "from clplen import errors", True),
    ],
)
def test_a_planted_arrow_is_judged(tmp_path: Path, module: str, text: str, is_wrong: bool) -> None:
    for name in (
        "wave/field",
        "wave/phase",
        "lightfield/raw",
        "cameras/scene",
        "compute/device",
        "io/pfm",
        "plot",
        "batch",
        "config",
        "demo",
        "cli",
        "errors",
        "other",
    ):
        file = tmp_path / f"clplen/{name}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text if name == module else "")
        (file.parent / "__init__.py").touch()
    assert bool(wrong_arrows(read(tmp_path / "clplen"))) == is_wrong


def test_a_planted_guest_and_a_planted_circle_are_found() -> None:
    welcome = {"clplen.io.hdf5": [("h5py", 1)], "clplen.plot": [("matplotlib.cm", 1)]}
    assert wrong_guests(welcome) == []
    assert wrong_guests({"clplen.cli": [("h5py", 3)]}) == ["clplen.cli:3 imports h5py"]
    ring = {"clplen.wave.a": [("clplen.wave.b", 1)], "clplen.wave.b": [("clplen.wave.a", 1)]}
    assert len(circle(ring)) == 3
    assert circle({"clplen.wave.a": [("clplen.wave.b", 1)], "clplen.wave.b": []}) == []


IMPORT = """
import sys
import pyopencl

def touched(*_):
    raise SystemExit("a device was touched")

pyopencl.get_platforms = pyopencl.create_some_context = touched
import clplen
absent = "matplotlib h5py tifffile imageio click tqdm pydantic ducc0 pyvkfft".split()
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
