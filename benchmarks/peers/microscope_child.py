"""One program of `peers/microscope.py` in a process, and perhaps an interpreter, of its own.

python benchmarks/peers/microscope_child.py NAME SETUP.npz

It needs NumPy and the program named alone. Each line that it reads is an order, each line that it
writes an answer (JSON): "images" makes the point images, "weights" what every voxel sees of an even
frame, "step" one iteration of Richardson and Lucy, "volume" writes the volume beside the set-up.
Whatever programs print goes to the standard error.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


class Program:
    """Projections of a program, with volumes (planes, rows, columns) and frames (rows, columns).

    Parameters
    ----------
    setup : mapping
        Numbers of `peers/microscope.py`: SI units.
    """

    module = ""

    def __init__(self, setup: Any) -> None:
        self.setup = {name: setup[name][()] for name in setup}

    def make_images(self) -> None:
        """Simulate the point images, and all that is made of them once."""
        raise NotImplementedError

    def forward(self, volume: Array) -> Array:
        """The frame of a volume."""
        raise NotImplementedError

    def backward(self, frame: Array) -> Array:
        """What voxels see of a frame."""
        raise NotImplementedError

    def microns(self, name: str) -> float:
        """A length of the set-up."""
        return round(1e6 * float(self.setup[name]), 9)

    @property
    def depths(self) -> Array:
        """z of the planes in micrometres."""
        return np.round(1e6 * self.setup["planes"], 9)


class Clplen(Program):
    """This package."""

    module = "clplen"

    def make_images(self) -> None:
        import clplen

        s = self.setup
        device = clplen.Device.open(str(s["device"]) or None)
        mla = clplen.MicrolensArray(s["pitch"], s["focal"], count=5, fill="full")
        camera = clplen.PlenopticCamera.microscope(
            magnification=s["magnification"], na=s["na"], medium_index=s["index"], mla=mla,
            wavelength=s["wavelength"], pixels_per_lenslet=int(s["pixels"] * s["fine"]),
            device=device,
        )  # fmt: skip
        images = clplen.point_images(
            camera, s["planes"], voxels_per_lenslet=int(s["pixels"]), binning=int(s["fine"])
        )
        lenslets = int(s["lenslets"])
        memory = None if s["memory"] < 0 else int(s["memory"])
        self.projector = clplen.Projector(
            images, (lenslets, lenslets), device=device, memory=memory
        )

    def forward(self, volume: Array) -> Array:
        return self.projector.forward(volume)

    def backward(self, frame: Array) -> Array:
        return self.projector.backward(frame)


class Pyolaf(Program):
    """github.com/lambdaloop/pyolaf, on the CPU."""

    module = "pyolaf"

    def make_images(self) -> None:
        import yaml  # type: ignore[import-untyped]
        from pyolaf.geometry import LFM_computeGeometryParameters, LFM_setCameraParams
        from pyolaf.lf import LFM_computeLFMatrixOperators

        n = int(self.setup["pixels"])
        about = {
            "gridType": "reg", "focus": "single", "plenoptic": 1, "uLensMask": 1,
            "M": float(self.setup["magnification"]), "NA": float(self.setup["na"]),
            "n": float(self.setup["index"]), "WaveLength": self.microns("wavelength"),
            "ftl": self.microns("tube"), "fm": self.microns("focal"),
            "lensPitch": self.microns("pitch"), "pixelPitch": self.microns("pitch") / n,
            "tube2mla": 0, "mla2sensor": 0,
        }  # fmt: skip
        Path("camera.yaml").write_text(yaml.safe_dump(about))
        camera = LFM_setCameraParams("camera.yaml", n)
        z = self.depths
        size = np.array([n * int(self.setup["lenslets"])] * 2)
        self.centers, self.resolution, _, _ = LFM_computeGeometryParameters(
            camera, np.zeros(0), [z[0], z[-1]], z[1] - z[0], n, False, size
        )
        self.there, self.back = LFM_computeLFMatrixOperators(camera, self.resolution, self.centers)
        self.size, self.range = size, camera["range"]

    def forward(self, volume: Array) -> Array:
        from pyolaf.project import LFM_forwardProject

        stack = np.ascontiguousarray(np.moveaxis(volume, 0, -1))
        return LFM_forwardProject(
            self.there, stack, self.centers, self.resolution, self.size, self.range, step=8
        )

    def backward(self, frame: Array) -> Array:
        from pyolaf.project import LFM_backwardProject

        stack = LFM_backwardProject(
            self.back, frame, self.centers, self.resolution, self.size, self.range, step=8
        )
        return np.moveaxis(stack, -1, 0)


class NapariLf(Program):
    """github.com/PolarizedLightFieldMicroscopy/napari-LF: its folder src/napari_lf/lfa."""

    module = "lflib"

    def make_images(self) -> None:
        from lflib.optics import LensletArray
        from lflib.volume import LightFieldProjection

        n, count, z = int(self.setup["pixels"]), int(self.setup["lenslets"]), self.depths
        array = LensletArray(
            n, n, count, count, self.microns("pitch"), self.microns("pitch") / n,
            self.microns("focal"), self.microns("focal"), float(self.setup["magnification"]),
            float(self.setup["na"]), float(self.setup["index"]), 1e3 * float(self.setup["tube"]),
            center_wavelength=1e9 * float(self.setup["wavelength"]),
        )  # fmt: skip
        database = array.physical_rayspread_database(
            len(z), float(np.mean(z)), float(z[1] - z[0]), supersample_factor=n,
            voxels_as_points=True,
        )  # fmt: skip
        self.projection = LightFieldProjection(None, database, gpu_id=0)
        self.counts = n, n, count, count

    def forward(self, volume: Array) -> Array:
        from lflib.lightfield import LightField

        stack = np.ascontiguousarray(np.moveaxis(volume, 0, -1))
        found = self.projection.project(stack, use_sing_prec=False)
        return found.asimage(representation=LightField.TILED_LENSLET)

    def backward(self, frame: Array) -> Array:
        from lflib.lightfield import LightField

        light = LightField(
            frame.astype(np.float32), *self.counts, representation=LightField.TILED_LENSLET
        )
        return np.moveaxis(self.projection.backproject(light, use_sing_prec=False), -1, 0)


class FastLightField(Program):
    """github.com/jmtayloruk/fast-light-field: its folder, with both extensions built in place."""

    module = "lfdeconv"

    def make_images(self) -> None:
        import psfmatrix

        z, about = self.depths, self.setup
        name = (
            f"fdnormPSFmatrix_M{about['magnification']:g}NA{about['na']:g}"
            f"MLPitch{self.microns('pitch'):g}fml{self.microns('focal'):g}from{z[0]:g}to{z[-1]:g}"
            f"zspacing{z[1] - z[0]:g}Nnum{about['pixels']}"
            f"lambda{1e9 * about['wavelength']:g}n{about['index']:g}.mat"
        )
        self.matrix = psfmatrix.LoadMatrix(name, createPSF=True)

    def forward(self, volume: Array) -> Array:
        import lfdeconv

        stack = np.ascontiguousarray(volume[:, None], np.float32)
        return lfdeconv.ForwardProjectACC(self.matrix, stack, progress=None, logPrint=False)[0]

    def backward(self, frame: Array) -> Array:
        import lfdeconv

        one = np.ascontiguousarray(frame[None], np.float32)
        return lfdeconv.BackwardProjectACC(self.matrix, one, progress=None, logPrint=False)[:, 0]


PROGRAMS = {
    "clplen": Clplen, "pyolaf": Pyolaf, "napari-LF": NapariLf, "fast-light-field": FastLightField,
}  # fmt: skip


class Session:
    """The iteration of a program, order by order."""

    def __init__(self, name: str, path: Path) -> None:
        self.program = PROGRAMS[name](np.load(path))
        self.frame = self.program.setup["frame"].astype(np.float32)
        self.path = path.with_name(f"{name}.npy")
        self.version = version_of(self.program.module)
        os.chdir(path.parent)

    def images(self) -> None:
        """Make the point images."""
        self.program.make_images()

    def weights(self) -> None:
        """Voxels' sums, and the start: an even volume of the light of the frame."""
        self.seen = self.program.backward(np.ones_like(self.frame))
        light = float(self.frame.sum()) / float(self.seen.sum())
        self.volume = np.full(self.seen.shape, light, np.float32)
        self.least = 1e-6 * float(self.seen.max())

    def step(self) -> float:
        """One iteration; the residual before it, sum (I - a H x)^2 / sum I^2 with the best a."""
        expected = self.program.forward(self.volume)
        off = self.frame - expected * (np.vdot(expected, self.frame) / np.vdot(expected, expected))
        lit = expected > 0
        ratio = np.where(lit, self.frame / np.where(lit, expected, 1), 0).astype(np.float32)
        seen = self.seen > self.least
        factor = np.where(seen, self.program.backward(ratio) / np.where(seen, self.seen, 1), 0)
        self.volume = (self.volume * factor).astype(np.float32)
        return float(np.square(off).sum() / np.square(self.frame).sum())

    def residual(self) -> float:
        """That of the volume found."""
        volume = self.volume
        found = self.step()
        self.volume = volume
        return found

    def write(self) -> str:
        """Write the volume; its path."""
        np.save(self.path, self.volume)
        return str(self.path)


def version_of(module: str) -> str:
    """Version of a program: that of the package, or the commit of its folder."""
    import importlib
    import importlib.metadata

    found = importlib.import_module(module)
    folder = str(Path(str(found.__file__)).parent)
    asked = ["git", "-C", folder, "log", "-1", "--format=%h of %cs"]
    try:
        return importlib.metadata.version(module)
    except importlib.metadata.PackageNotFoundError:
        told = subprocess.run(asked, capture_output=True, text=True, check=False)
        return told.stdout.strip() or "of unknown version"


def cpu_seconds() -> float:
    """Of all threads, and of processes that have ended."""
    return float(sum(os.times()[:4]))


def peak(*, again: bool) -> float:
    """The most memory that the process had in MB, or 0; with ``again`` it is counted anew."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        found = next(1.024e-3 * int(one.split()[1]) for one in lines if one.startswith("VmHWM"))
        if again:
            Path("/proc/self/clear_refs").write_text("5")
    except (OSError, StopIteration):
        return 0.0
    return found


def serve() -> None:
    """Answer orders until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what programs print
    session: Session | None = None
    for line in sys.stdin:
        order = line.strip()
        answer: dict[str, Any]
        try:
            if session is None:
                session = Session(sys.argv[1], Path(sys.argv[2]).resolve())
                answer = {"version": session.version}
            else:
                start, used = time.perf_counter(), cpu_seconds()
                value = getattr(session, order)()
                answer = {
                    "value": value, "seconds": time.perf_counter() - start,
                    "cpu": cpu_seconds() - used, "peak": peak(again=order == "images"),
                }  # fmt: skip
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    serve()
