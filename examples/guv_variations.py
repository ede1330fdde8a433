"""What the volume of a giant vesicle depends on: planes, pixels, voxels, index, haze, white frame.

Residual after 20 iterations, radii by rays up to 45 degrees from the equator, light outside.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shell
import vesicle
from common import Run, begin
from guv_volume import ITERATIONS, PIXELS, WITHIN, prepared, radii


def planes(last: float, step: float) -> np.ndarray:
    """z in metres from um."""
    return np.arange(-last, last + step / 2, step) * 1e-6


def turned(seen: vesicle.Seen) -> vesicle.Seen:
    """With every sub-image turned by 180 degrees."""
    def cells(values: np.ndarray) -> np.ndarray:
        rows, columns = (size // PIXELS for size in values.shape)
        split = values.reshape(rows, PIXELS, columns, PIXELS)
        return split[:, ::-1, :, ::-1].reshape(values.shape)

    return replace(seen, counts=cells(seen.counts), white=cells(seen.white), haze=cells(seen.haze))


def tried(word: str, run: Run, seen: vesicle.Seen, *, z: np.ndarray, pixels: int = PIXELS,
          voxels: int = 3, index: float = 1.35) -> None:
    """One volume, in numbers."""
    cam = vesicle.camera(run.device, pixels, index=index)
    bench = prepared(seen, cam, z, voxels, ITERATIONS)
    result = bench.volume(word)
    found = bench.shell(result, WITHIN[-1])
    outside = shell.contrast(result.volume, bench.voxels, found)[1]
    print(f"  {word}: {radii(found)}; z of the centre {found.centre[0] * 1e6:.2f} um; outside "
          f"{outside:.3f} of the shell's light")


def main() -> None:
    """One after the other."""
    run = begin(__doc__, __file__, quick="two of them")
    frame, white, dark, words = vesicle.frames(run)
    print(f"  {words}")
    seen = vesicle.seen(frame, white, dark, PIXELS, run.device)
    z = planes(25, 2) if vesicle.REAL else planes(11, 2)
    tried("planes 2 um apart", run, seen, z=z)
    tried("index 1.33", run, seen, z=z, index=1.33)
    if run.quick:
        return
    tried("planes 1 um apart to 2/3 as far", run, seen, z=planes(round(z[-1] * 1e6 / 1.5), 1))
    tried("planes 2 um apart to 4/3 as far", run, seen, z=planes(round(z[-1] * 1e6 / 0.75), 2))
    tried("16 pixels", run, vesicle.seen(frame, white, dark, 16, run.device), z=z, pixels=16)
    tried("5 x 5 voxels", run, seen, z=z, voxels=5)
    tried("sub-images turned", run, turned(seen), z=z)
    clear = replace(seen, haze=np.zeros_like(seen.haze))
    tried("haze left in", run, clear, z=z)
    pupils = (seen.haze / seen.haze.mean()).astype(np.float32)
    tried("haze left in, white frame as it is", run, replace(clear, white=pupils), z=z)


if __name__ == "__main__":
    main()
