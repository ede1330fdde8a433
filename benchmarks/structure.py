"""The package's structure in figures: modules, folders, circles of imports, and five calls
followed.

    python benchmarks/structure.py [folder of another checkout ...]

prints one row a figure and one column a checkout. An import counts wherever it stands, under
``TYPE_CHECKING`` and inside functions too. A call is followed by the profiler: the modules of the
package that it enters (those above `clplen.compute`, and all), and its climbs, calls from a module
into one that imports it, directly or through others.
"""

from __future__ import annotations

import argparse
import ast
import collections
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

TOPICS = ("analysis", "batch", "cameras", "io", "lightfield", "microscopy", "plot", "wave")
BRIDGES = ("jax", "torch")  # topics that need another library
SCRIPTS = (*TOPICS, *BRIDGES, "bench", "demo")  # what examples and benchmarks may import
SMALL = 80  # lines
CALLS = r"""
import json, os, sys, tempfile, threading
import numpy as np
import clplen
device = clplen.Device.open("cpu")
grid = clplen.Grid((256, 250), 5e-6)
values = np.random.default_rng(1).random(grid.shape).astype(np.complex64)
field = clplen.Field.from_array(values, grid, wavelength=532e-9, device=device)
mla = clplen.MicrolensArray(150e-6, 10e-3, count=41, fill="full")
camera = clplen.PlenopticCamera.type1(
    focal_length=0.12, mla=mla, wavelength=532e-9, pixels_per_lenslet=30, device=device)
scene = clplen.PointSources([(0, 0, -0.05)])
views = np.random.default_rng(2).random((3, 3, 40, 44)).astype(np.float32)
lf = clplen.LightField.from_array(views, device=device)
folder = tempfile.mkdtemp()
from PIL import Image
for v in range(3):
    for u in range(3):
        image = Image.fromarray((255 * views[v, u]).astype(np.uint8))
        image.save(os.path.join(folder, f"view_{v}_{u}.png"))
lenslets = clplen.MicrolensArray(125e-6, 2.5e-3, count=5, fill="full")
microscope = clplen.PlenopticCamera.microscope(
    magnification=20, na=0.5, mla=lenslets, wavelength=525e-9, pixels_per_lenslet=25, device=device)
images = clplen.point_images(microscope, np.array([-2e-5, 2e-5]), voxels_per_lenslet=5)
projector = clplen.Projector(images, (5, 5), device=device)
frame = np.random.default_rng(3).random((125, 125)).astype(np.float32)
calls = {
    "propagate": lambda: clplen.propagate(field, 0.05),
    "expose": lambda: camera.expose(scene),
    "read_lightfield": lambda: clplen.read_lightfield(folder, device=device),
    "focal_stack": lambda: clplen.focal_stack(lf, disparities=[-0.5, 0.5]),
    "deconvolve": lambda: clplen.deconvolve(frame, projector, iterations=2),
}
root = os.path.dirname(clplen.__file__)

def module(frame):
    path = os.path.relpath(frame.f_code.co_filename, os.path.dirname(root))
    return path[:-3].replace(os.sep, ".").removesuffix(".__init__")

def follow(call):
    edges = []
    def profile(frame, event, _):
        if event == "call" and frame.f_code.co_filename.startswith(root):
            back = frame.f_back
            while back is not None and not back.f_code.co_filename.startswith(root):
                back = back.f_back
            if frame.f_code.co_name != "<module>":
                edges.append((module(back) if back is not None else "", module(frame)))
    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(None)
    return list(dict.fromkeys(edges))

print(json.dumps({name: follow(call) for name, call in calls.items()}))
"""


def module_name(file: Path, root: Path) -> str:
    """The dotted name of a file."""
    parts = file.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(file: Path, modules: set[str]) -> Iterator[tuple[str, str]]:
    """(module, name) of all imports from the package."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "clplen":
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield (full, "") if full in modules else (str(node.module), alias.name)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "clplen":
                    yield alias.name, ""


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that reach each other (Tarjan 1972)."""
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    groups = []

    def visit(module: str) -> None:
        number[module] = low[module] = len(number)
        stack.append(module)
        for target in graph[module]:
            if target not in number:
                visit(target)
                low[module] = min(low[module], low[target])
            elif target in stack:
                low[module] = min(low[module], number[target])
        if low[module] == number[module]:
            group = []
            while not group or group[-1] != module:
                group.append(stack.pop())
            if len(group) > 1:
                groups.append(sorted(group))

    for module in graph:
        if module not in number:
            visit(module)
    return groups


def reached(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """All modules that each module imports, directly or through others."""
    below: dict[str, set[str]] = {}
    for module in graph:
        seen: set[str] = set()
        waiting = [module]
        while waiting:
            for target in graph[waiting.pop()] - seen:
                seen.add(target)
                waiting.append(target)
        below[module] = seen
    return below


def public_names(file: Path) -> list[str]:
    """Names that a module lists: in the stub beside it, else in its literal ``__all__``."""
    stub = file.with_suffix(".pyi")
    if stub.exists():
        nodes = [n for n in ast.parse(stub.read_text()).body if isinstance(n, ast.ImportFrom)]
        names = [alias.asname or alias.name for node in nodes for alias in node.names]
        return [name for name in names if name not in (*TOPICS, *BRIDGES)]
    for node in ast.parse(file.read_text()).body if file.exists() else ():
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return list(ast.literal_eval(node.value))
    return []


def private_imports(root: Path, modules: set[str]) -> list[str]:
    """Names that examples and benchmarks import and that are not public."""
    package = root / "clplen"
    public = {"clplen": {*public_names(package / "__init__.py"), *TOPICS, *BRIDGES, "demo"}}
    for topic in SCRIPTS:
        folder = package / topic
        file = folder / "__init__.py" if folder.is_dir() else package / f"{topic}.py"
        public[f"clplen.{topic}"] = set(public_names(file))
    hidden = []
    for folder in ("examples", "benchmarks"):
        for file in sorted((root / folder).rglob("*.py")):
            for module, name in imported(file, modules):
                if name and name not in public.get(module, ()):
                    hidden.append(f"{folder}/{file.name}: {module}.{name}")
                elif not name and module not in public:
                    hidden.append(f"{folder}/{file.name}: {module}")
    return hidden


def followed(root: Path, graph: dict[str, set[str]]) -> dict[str, str]:
    """Modules above `clplen.compute` (and all) and climbs of each call."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", CALLS],
        env=os.environ | {"PYTHONPATH": str(root), "CLPLEN_TUNING": "off"},
        stdout=subprocess.PIPE, text=True, check=True, cwd=root,
    )  # fmt: skip
    below = reached(graph)
    rows = {}
    for name, edges in json.loads(done.stdout.splitlines()[-1]).items():
        entered = {callee for _, callee in edges}
        above = {m for m in entered if not m.startswith("clplen.compute")}
        climbs = [(a, b) for a, b in edges if a in below.get(b, ()) and a != b]
        rows[f"{name}: modules entered, climbs"] = f"{len(above)} ({len(entered)}), {len(climbs)}"
        for caller, callee in climbs:
            print(f"  {name}: {caller} -> {callee}", file=sys.stderr)
    return rows


def figures(root: Path) -> dict[str, str]:
    """Every figure of a checkout."""
    files = sorted((root / "clplen").rglob("*.py"))
    names = {module_name(file, root): file for file in files}
    graph = {m: {t for t, _ in imported(f, set(names))} & set(names) for m, f in names.items()}
    texts = {m: f.read_text().splitlines() for m, f in names.items()}
    inner = {m for m, f in names.items() if f.name != "__init__.py"}
    importers = collections.Counter(t for m, targets in graph.items() for t in targets - {m})
    folders = collections.Counter(m.rpartition(".")[0] for m in inner)
    stems = collections.Counter(m.rpartition(".")[2] for m in inner)
    folder, most = folders.most_common(1)[0]
    rings = circles(graph)
    for ring in rings:
        print("  circle:", *ring, file=sys.stderr)
    code = sum(bool(x.strip()) and x.strip()[0] != "#" for t in texts.values() for x in t)
    rows = {
        "modules": str(len(files)),
        "lines (neither empty nor comments)": str(code),
        "largest folder": f"{most} ({folder})",
        f"modules under {SMALL} lines": str(sum(len(texts[m]) < SMALL for m in inner)),
        "modules with one importer": str(sum(importers[m] == 1 for m in inner)),
        "circles (modules in them)": f"{len(rings)} ({sum(map(len, rings))})",
        "public names on top": str(len(public_names(root / "clplen/__init__.py"))),
        "imports of examples and benchmarks that are not public": str(
            len(private_imports(root, set(names)))
        ),
        "stems in two folders": str(sum(n > 1 for n in stems.values())),
    }
    return rows | followed(root, graph)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("others", nargs="*", type=Path, help="other checkouts, to compare with")
    roots = [*parser.parse_args().others, Path(__file__).parents[1]]
    columns = [figures(root.resolve()) for root in roots]
    print("| figure | " + " | ".join(root.resolve().name for root in roots) + " |")
    print("|---|" + "---|" * len(roots))
    for row in columns[-1]:
        print(f"| {row} | " + " | ".join(column.get(row, "") for column in columns) + " |")


if __name__ == "__main__":
    main()
