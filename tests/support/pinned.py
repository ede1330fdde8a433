"""Pins what clplen computes, writes and says, so that code can be moved and deleted in safety.

    python tests/support/pinned.py record FOLDER [NAME...]
    python tests/support/pinned.py compare OLD NEW [--expected FILE]
    python tests/support/pinned.py against REVISION [NAME...] [--expected FILE]

A case is a function of `pinned_results.py` or `pinned_surfaces.py` that uses public names and
commands only. `record` runs each in a folder of its own and keeps what it returns, its exception,
its warnings and the files that it leaves: numbers in arrays.npz, words in words.json. `against`
records the cases of this checkout with the package of another revision and with the one here, and
compares. NAME is a pattern of cases, such as "propagate*". A line "NAME: reason" of the file of
expected differences allows cases to differ; the exit status is 1 if any other does.

The package is the one that Python finds: set PYTHONPATH to the checkout.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import fnmatch
import hashlib
import io
import json
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

# One thread a process, so that sums of floats by atomics have an order.
os.environ.update(CLPLEN_TUNING="off", MPLBACKEND="agg", COLUMNS="100")
os.environ.update(OMP_NUM_THREADS="1", POCL_MAX_PTHREAD_COUNT="1")
for word in ("CLPLEN_LYTRO", "CLPLEN_DATA"):
    os.environ.pop(word, None)

import numpy as np  # noqa: E402 - after the variables that say how many threads it takes

HERE = Path(__file__).resolve().parents[2]
WORKERS = 2  # fixed, so that every process runs the same cases in the same order
LONGEST = 20_000  # characters of a text that is kept; of a longer one its digest is
# What differs from run to run.
CHANGING = (
    (re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?"), "DATE"),
    (re.compile(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}"), "UUID"),
    (re.compile(r"0x[0-9a-f]{6,}"), "ADDRESS"),
    (re.compile(r"The process \d+ on \S+"), "The process N on HOST"),
    (re.compile(r'"(changed|compute|digest|read|started|total|waiting|write)": [\d.e-]+'), "N"),
    (re.compile(r'"(sha256|worker)": "[^"]+"'), "WORD"),
    (re.compile(r"\d\.\d{12,}(e[-+]\d+)?"), lambda found: f"{float(found[0]):.7g}"),
)

Case = Callable[[], Any]
Leaf = np.ndarray | str
CASES: dict[str, Case] = {}


def pinned(**inputs: Mapping[str, Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Register a function as a case, or as one for each of its inputs, by their labels."""

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        for label, words in (inputs or {"": {}}).items():
            add(f"{function.__name__} {label}".strip(), lambda words=words: function(**words))
        return function

    return register


def add(name: str, case: Case) -> None:
    """Register a case under a name that nobody has."""
    assert name not in CASES, f"{name} is taken"
    CASES[name] = case


def parts(thing: Any, names: str) -> dict[str, Any]:
    """Attributes of an object, by their names with blanks between them."""
    return {name: getattr(thing, name) for name in names.split()}


# Recording


def plain(text: str) -> str:
    """A text without what depends on the run: folders, dates, version."""
    import clplen

    for folder in (Path.cwd(), Path(clplen.__file__).parents[1], HERE):
        text = text.replace(str(folder), "FOLDER")
    text = text.replace(clplen.__version__, "VERSION")
    for pattern, word in CHANGING:
        text = pattern.sub(word, text)
    return text


def leaves(value: Any, at: str = "") -> Iterator[tuple[str, Leaf]]:
    """Arrays and texts of a result, by their paths in it."""
    if hasattr(value, "to_numpy"):
        value = value.to_numpy()
    if isinstance(value, Mapping):
        for key, one in value.items():
            yield from leaves(one, f"{at}/{key}")
    elif hasattr(value, "findobj"):
        yield from leaves(drawn(value), at)
    elif value is None or isinstance(value, str | bool):
        yield at, plain(str(value))
    elif isinstance(value, list | tuple) and not all(isinstance(i, int | float) for i in value):
        for number, one in enumerate(value):
            yield from leaves(one, f"{at}/{number}")
    else:
        array = np.asarray(value)
        if array.dtype.hasobject or array.dtype.kind in "SU":
            array = np.asarray([plain(str(one)) for one in array.ravel()])
            yield at, "\n".join(array)
        else:
            yield at, array


def drawn(figure: Any) -> dict[str, Any]:
    """What a figure shows: its words, lines, images and the ends of its axes."""
    figure.draw_without_rendering()
    found: dict[str, Any] = {"text": "\n".join(
        text.get_text() for text in figure.findobj(lambda one: hasattr(one, "get_text"))
        if text.get_visible() and text.get_text()
    )}  # fmt: skip
    for number, axes in enumerate(figure.axes):
        found[f"{number}"] = {
            "ends": [*axes.get_xlim(), *axes.get_ylim()],
            "lines": [np.asarray(line.get_xydata()) for line in axes.lines] or "none",
            "images": [np.ma.filled(i.get_array(), np.nan) for i in axes.images] or "none",
        }
    return found


def files() -> Iterator[tuple[str, Leaf]]:
    """What lies in the present folder, decoded where it is arrays."""
    for path in sorted(path for path in Path().rglob("*") if path.is_file()):
        try:
            yield from leaves(decoded(path), f"/{path}")
        except Exception as error:
            yield f"/{path}", plain(f"unreadable: {error}")


def decoded(path: Path) -> Any:
    """Arrays or text of a file."""
    kind = path.suffix.lower()
    if kind == ".npy":
        return np.load(path)
    if kind in (".tif", ".tiff"):
        import tifffile

        with tifffile.TiffFile(path) as file:
            return {"pixels": file.asarray(), "words": file.pages[0].description}
    if kind in (".png", ".gif"):
        from PIL import Image, ImageSequence

        with Image.open(path) as file:  # of a GIF some frames have a palette and others none
            frames = ImageSequence.Iterator(file) if kind == ".gif" else ()
            return np.stack([np.array(one.convert("RGB")) for one in frames] or [np.array(file)])
    if kind == ".h5":
        import h5py

        found: dict[str, Any] = {}

        def keep(name: str, part: Any) -> None:
            found[name] = part[()] if isinstance(part, h5py.Dataset) else "group"
            found.update({f"{name}@{key}": value for key, value in part.attrs.items()})

        with h5py.File(path) as file:
            keep("", file)
            file.visititems(keep)
        return found
    if kind == ".pfm":
        import clplen

        return clplen.io.read_pfm(path)
    if kind in (".mp4", ".pdf", ".svg", ".sqlite") or ".sqlite" in path.name:
        return "there"
    try:
        text = plain(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    return text if len(text) < LONGEST else hashlib.sha256(text.encode()).hexdigest()


def run_case(name: str) -> dict[str, Leaf]:
    """Run a case in an empty folder, and return all that came of it."""
    kept: dict[str, Leaf] = {}
    quiet = contextlib.redirect_stdout(io.StringIO())
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as said:
        os.chdir(folder)
        warnings.simplefilter("always")
        try:
            with quiet:
                kept.update(leaves(CASES[name]()))
        except Exception as error:
            kept["/error"] = plain(f"{type(error).__name__}: {error}")
        words = {plain(f"{one.category.__name__}: {one.message}") for one in said
                 if issubclass(one.category, UserWarning | FutureWarning)}  # fmt: skip
        if words:
            kept["/warnings"] = "\n".join(sorted(words))
        kept.update((f"/files{at}", leaf) for at, leaf in files())
        os.chdir(HERE)
    return kept


def run_share(names: list[str]) -> dict[str, dict[str, Leaf]]:
    """Run some cases, one after the other."""
    load()
    return {name: run_case(name) for name in names}


def load() -> None:
    """Fill the table of cases."""
    sys.modules["pinned"] = sys.modules[__name__]
    import pinned_surfaces  # noqa: F401 - it and pinned_results, which it imports, register cases


def record(folder: Path, patterns: list[str]) -> None:
    """Record the cases whose names fit one of the patterns, or all."""
    load()
    names = [name for name in CASES if not patterns or fits(name, patterns)]
    shares = [names[first::WORKERS] for first in range(WORKERS)]
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(WORKERS, mp_context=fresh) as pool:
        found = {name: one for share in pool.map(run_share, shares) for name, one in share.items()}
    folder.mkdir(parents=True, exist_ok=True)
    arrays, words = {}, {}
    for name in names:
        kept = found[name] or {"": "nothing"}
        words[name] = {at: leaf for at, leaf in kept.items() if isinstance(leaf, str)}
        arrays |= {f"{name}:{at}": one for at, one in kept.items() if not isinstance(one, str)}
    np.savez_compressed(folder / "arrays.npz", **arrays)
    (folder / "words.json").write_text(json.dumps(words, indent=1), encoding="utf-8")
    raised = sum("/error" in found[name] for name in names)
    print(f"{folder} holds {len(names)} cases, {raised} of which end with an error.")


def fits(name: str, patterns: list[str]) -> bool:
    """Whether a name fits any of the patterns."""
    return any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)


# Comparing


def recorded(folder: Path) -> dict[str, dict[str, Leaf]]:
    """What `record` left in a folder."""
    if not (folder / "words.json").is_file():
        sys.exit(f"{folder} holds no record: make one by 'pinned.py record {folder}'.")
    found: dict[str, dict[str, Leaf]] = json.loads((folder / "words.json").read_text("utf-8"))
    with np.load(folder / "arrays.npz") as arrays:
        for key in arrays.files:
            name, _, at = key.partition(":")
            found[name][at] = arrays[key]
    return found


def differences(old: dict[str, Leaf], new: dict[str, Leaf]) -> Iterator[str]:
    """Lines that say what differs between two records of a case."""
    for at in sorted(old.keys() | new.keys()):
        if at not in new or at not in old:
            value = old.get(at, new.get(at))
            shown = value[:200] if isinstance(value, str) else f"array {value.shape}"
            yield f"{at} {'missing' if at not in new else 'new'}: {shown}"
        elif isinstance(old[at], str) and isinstance(new[at], str):
            lines = (str(one[at]).splitlines() for one in (old, new))
            changes = list(difflib.unified_diff(*lines, n=0, lineterm=""))[2:]
            yield from [f"{at}:"] * bool(changes) + [f"    {line[:200]}" for line in changes[:10]]
        elif not isinstance(old[at], str) and not isinstance(new[at], str):
            yield from [f"{at}: {line}" for line in [apart(old[at], new[at])] if line]
        else:
            yield f"{at}: numbers here, a text there"


def apart(a: np.ndarray, b: np.ndarray) -> str:
    """How far two arrays are apart, empty for the same bits."""
    if a.shape != b.shape or a.dtype != b.dtype:
        return f"{a.dtype} {a.shape} became {b.dtype} {b.shape}"
    if a.tobytes() == b.tobytes():
        return ""
    a, b = (one.astype(complex if np.iscomplexobj(one) else float) for one in (a, b))
    if not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return "other values are NaN or infinite"
    off = np.abs(np.where(np.isfinite(a), a - b, 0)).max()
    return f"{off / np.abs(a[np.isfinite(a)]).max(initial=1e-300):.1e} of the largest value"


def compare(old: Path, new: Path, expected: Path | None) -> int:
    """Print what differs between two records; return the exit status."""
    before, after = recorded(old), recorded(new)
    reasons = {}
    if expected is not None:
        lines = expected.read_text(encoding="utf-8").splitlines()
        reasons = dict(line.split(": ", 1) for line in lines if line.strip() and line[0] != "#")
    states: dict[str, list[str]] = {state: [] for state in ("same", "other", "missing", "new")}
    unexpected = []
    for name in sorted(before.keys() | after.keys()):
        lines = list(differences(before.get(name, {}), after.get(name, {})))
        state = "new" if name not in before else "missing" if name not in after else "other"
        states[state if lines else "same"].append(name)
        if not lines:
            continue
        reason = next((reasons[one] for one in reasons if fits(name, [one])), None)
        unexpected += [name] * (reason is None)
        print(f"{name}: {state}" + (f", as expected: {reason}" if reason else ""))
        if state == "other" and reason is None:
            print("\n".join(f"    {line}" for line in lines))
    for one in reasons:
        if not any(fits(name, [one]) for name in [*before, *after] if name not in states["same"]):
            print(f"{one}: is the same, though it is expected to differ")
    print(f"{len(states['same'])} cases are the same, {len(states['other'])} differ,", end=" ")
    print(f"{len(states['missing'])} are missing, {len(states['new'])} new;", end=" ")
    print(f"{len(unexpected)} of these are not expected.")
    return int(bool(unexpected))


def against(revision: str, patterns: list[str], expected: Path | None) -> int:
    """Compare this checkout with a revision, on the cases of this checkout."""
    with tempfile.TemporaryDirectory() as folder:
        there, git = Path(folder, "tree"), ["git", "-C", str(HERE), "worktree"]
        subprocess.run([*git, "add", "--detach", "-q", there, revision], check=True)
        try:
            for name, tree in (("old", there), ("new", HERE)):
                words = [sys.executable, __file__, "record", Path(folder, name), *patterns]
                subprocess.run(words, check=True, env=os.environ | {"PYTHONPATH": str(tree)})
        finally:
            subprocess.run([*git, "remove", "--force", there], check=True)
        return compare(Path(folder, "old"), Path(folder, "new"), expected)


def main() -> int:
    """Do what the command line says."""
    words = argparse.ArgumentParser(description=__doc__)
    words.formatter_class = argparse.RawDescriptionHelpFormatter
    kinds = words.add_subparsers(dest="kind", required=True)
    one = kinds.add_parser("record")
    one.add_argument("folder", type=Path)
    one.add_argument("names", nargs="*")
    one = kinds.add_parser("compare")
    one.add_argument("old", type=Path)
    one.add_argument("new", type=Path)
    one.add_argument("--expected", type=Path)
    one = kinds.add_parser("against")
    one.add_argument("revision")
    one.add_argument("names", nargs="*")
    one.add_argument("--expected", type=Path)
    said = words.parse_args()
    if said.kind == "record":
        record(said.folder, said.names)
        return 0
    if said.kind == "compare":
        return compare(said.old, said.new, said.expected)
    return against(said.revision, said.names, said.expected)


if __name__ == "__main__":
    sys.exit(main())
