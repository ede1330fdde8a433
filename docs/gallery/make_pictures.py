"""Draw the gallery's pictures: python docs/gallery/make_pictures.py [--all] [--quick] [SCRIPT ...]

The command runs the scripts of examples/ that changed since their pictures were drawn. It writes a
WebP of at most 40 kB and a thumbnail for each, so that the site needs no device. thumbnails.toml
holds the part of the figure that the thumbnail shows. runs.json holds the run time and the digest
of each script with the modules beside it that it imports; tests/test_site.py checks the digests.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from PIL import Image, ImageOps, ImageStat

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[1] / "examples"
FRAMES = ("guv_volume", "guv_variations", "bead_positions", "bead_volume")
LARGEST = 40_000  # bytes
WIDTH = 1200  # pixels
THUMBNAIL = (300, 200)  # pixels


def scripts() -> list[str]:
    """Names of all scripts that draw."""
    return [*sorted(path.stem for path in EXAMPLES.glob("fig_*.py")), *FRAMES]


def _modules(name: str) -> Iterator[str]:
    """A script and the modules of examples/ that it imports, once each."""
    waiting, seen = [name], {name}
    while waiting:
        module = waiting.pop()
        yield module
        for node in ast.walk(ast.parse((EXAMPLES / f"{module}.py").read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            else:
                continue
            for other in names:
                if other not in seen and (EXAMPLES / f"{other}.py").is_file():
                    seen.add(other)
                    waiting.append(other)


def digest(name: str) -> str:
    """Of a script with the modules of examples/ that it imports."""
    found = hashlib.sha256()
    for module in sorted(_modules(name)):
        found.update((EXAMPLES / f"{module}.py").read_bytes())
    return found.hexdigest()[:16]


def write_webp(picture: Path, target: Path) -> None:
    """Write a picture as WebP below the largest size."""
    with Image.open(picture) as opened:
        image = opened.convert("RGB")
    image.thumbnail((WIDTH, WIDTH))
    while True:
        for quality in (90, 80, 70, 60, 50):
            image.save(target, quality=quality, method=6)
            if target.stat().st_size <= LARGEST:
                return
        image.thumbnail((image.width * 4 // 5, image.height * 4 // 5))


def write_thumbnail(picture: Path, target: Path, box: list[float]) -> None:
    """Write the part ``box`` of a picture as a thumbnail, centred on the colour of its edge.

    The box holds left, top, right and bottom as fractions of the picture.
    """
    with Image.open(picture) as opened:
        image = opened.convert("RGB")
    width, height = image.size
    left, top, right, bottom = box
    panel = image.crop(
        (round(left * width), round(top * height), round(right * width), round(bottom * height))
    )
    edge = panel.crop((0, 1, panel.width, 3))
    colour = tuple(ImageStat.Stat(edge).median)
    panel = ImageOps.contain(panel, THUMBNAIL, Image.Resampling.LANCZOS)
    image = Image.new("RGB", THUMBNAIL, colour)
    image.paste(panel, tuple((a - b) // 2 for a, b in zip(THUMBNAIL, panel.size, strict=True)))
    image.save(target, quality=40, method=6)


def draw(name: str, quick: bool) -> dict[str, object]:
    """Run a script, write its picture; its entry in runs.json."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        command = [sys.executable, str(EXAMPLES / f"{name}.py"), "-o", folder]
        command += ["--quick"] * quick
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
        seconds = time.perf_counter() - start
        if done.returncode:
            raise SystemExit(f"{name} failed:\n{done.stderr}")
        pictures = sorted(Path(folder).rglob("*.png"))
        if pictures:
            write_webp(pictures[0], HERE / "pictures" / f"{name}.webp")
            settings = tomllib.loads((HERE / "thumbnails.toml").read_text(encoding="utf-8"))
            thumbnail = HERE / "thumbnails" / f"{name}.webp"
            write_thumbnail(pictures[0], thumbnail, settings[name]["box"])
    return {"digest": digest(name), "seconds": round(seconds, 1), "quick": quick}


def main() -> None:
    """Read the command line, draw what is to be drawn."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scripts", nargs="*", metavar="SCRIPT", help="default: those that changed")
    parser.add_argument("--all", action="store_true", help="every script")
    parser.add_argument("--quick", action="store_true", help="with less to compute")
    given = parser.parse_args()
    file = HERE / "runs.json"
    runs = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    for folder in ("pictures", "thumbnails"):
        (HERE / folder).mkdir(exist_ok=True)
    known = scripts()
    if unknown := set(given.scripts) - set(known):
        parser.error(f"there is no script {', '.join(sorted(unknown))} in {EXAMPLES}.")
    changed = [name for name in known if runs.get(name, {}).get("digest") != digest(name)]
    for name in known if given.all else given.scripts or changed:
        runs[name] = draw(name, given.quick)
        print(f"{name}: {runs[name]['seconds']} s", flush=True)
        runs = {key: runs[key] for key in known if key in runs}
        file.write_text(json.dumps(runs, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
