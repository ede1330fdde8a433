"""A slanted picture before a focused camera of three lens types, from near to far along x."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import gaussian_filter

from clplen import Image, MicrolensArray, PlenopticCamera, PointSources, SurfaceScene
from clplen.analysis.point.edge import slanted_edge
from clplen.cameras import Plane
from clplen.cameras.focused_camera import Plenoptic2
from clplen.cameras.optics.ray_optics import view_step
from clplen.cameras.scenes.textures import Texture, noise
from clplen.compute.device import Device
from clplen.lightfield.focused.focused_depth import FocusedDepth
from clplen.lightfield.focused.focused_picture import FocusedImage
from clplen.lightfield.raw.raw_image import RawImage

PITCH = 150e-6
MS = (0.2, 0.3, 0.13)  # in focus, one a type
FINE = 20  # samples of the texture a lenslet
GAP = 4.5  # lenslets from edge to edge
TILT = math.tan(math.radians(5))  # of edges, dx/dy
BAND = 4.0  # rows of lenslets on both sides of the axis that hold the edges


@dataclass(frozen=True, eq=False)
class Slanted:
    """The scene of a camera. Places (Y, X) are rows and columns of lenslets from the axis.

    Slanted edges on the axis' rows, rough texture above and below; ``ends`` are m at the left and
    the right end, ``span`` lenslets apart.
    """

    camera: Plenoptic2
    ends: tuple[float, float]
    span: float

    @property
    def beside(self) -> int:
        """Edges on each side of the middle one."""
        return int((self.span / 2 - 2) / GAP)

    @cached_property
    def _step(self) -> float:
        """d = (1 - beta) of this."""
        return view_step(self.camera) / PITCH

    def _d(self, m: float) -> float:
        z2 = self.camera.array_distance
        return (1 - z2 / (z2 - self.camera.b / m)) * self._step

    def plane(self, texture: Texture) -> Plane:
        """d is affine in X."""
        far, near = (self._d(m) for m in self.ends)
        return Plane((near + far) / 2, (0, (near - far) / self.span), texture=texture)

    def dz(self, X: np.ndarray) -> np.ndarray:
        """Of the plane, in metres."""
        return np.asarray(self.camera.dz(self._beta(X) * self._shorter))

    def m(self, X: np.ndarray) -> np.ndarray:
        """b/a of the plane."""
        return self.camera.b / (self.camera.array_distance * (1 - 1 / self._beta(X)))

    @property
    def _shorter(self) -> float:
        return self.camera.image_distance / self.camera.array_distance

    def _beta(self, X: np.ndarray) -> np.ndarray:
        plane = self.plane(flat())
        return 1 - (plane.disparity + plane.slope[1] * np.asarray(X)) / self._step

    def by_rays(self) -> RawImage:
        return self.camera.expose(SurfaceScene(self.plane(edges())), model="rays")

    def white(self) -> np.ndarray:
        scene = SurfaceScene(Plane(0.0, texture=flat(1.0)))
        return self.camera.expose(scene, model="rays").to_numpy()

    def by_waves(self, seed: int = 4, points: int = 160) -> RawImage:
        """Points in place of the texture, and lines of points in place of the edges."""
        at = np.arange(-BAND, BAND, 0.3)
        lines = [(at, n * GAP - TILT * at) for n in range(-self.beside, self.beside + 1)]
        random = np.random.default_rng(seed)
        half = np.array([self.camera.mla.count[0] / 2 - 2, self.span / 2])
        rough = random.uniform(-half, half, (points, 2))
        rough = rough[np.abs(rough[:, 0]) > BAND + 1]
        Y, X = np.concatenate([np.stack(line, -1) for line in lines] + [rough]).T
        dz = self.dz(X)
        metres = PITCH / self.camera.array_scale(dz)
        rows = self.camera.mla.row_pitch / PITCH
        return self.camera.expose(PointSources(np.stack([X * metres, Y * rows * metres, dz], -1)))

    def columns(self, depth: FocusedDepth) -> np.ndarray:
        """X of each sub-image."""
        geometry = depth.geometry
        return (geometry.centres[..., 1] - geometry.axis[1]) * self._scale

    @property
    def _scale(self) -> float:
        """Lenslets a pixel, along chief rays."""
        return self.camera.pixel_pitch / self.camera.sub_image_scale / PITCH

    def rms(self, depth: FocusedDepth) -> tuple[float, float, int]:
        """rms error of m relative to m, of z relative to the object's distance; how many count.

        Over the sure sub-images where at least three lenslets a row see a point.
        """
        X = self.columns(depth)
        true, z = self.m(X), self.dz(X)
        seen = (depth.confidence >= depth.sure) & (true <= 1 / 3)
        m = depth.m[seen] / true[seen] - 1
        far = (depth.z - z)[seen] / (self.camera.object_distance + z[seen])
        return float(np.sqrt((m**2).mean())), float(np.sqrt((far**2).mean())), int(seen.sum())

    def mtf50(self, picture: FocusedImage | Image, *, lines: bool = False) -> np.ndarray:
        """Of the edges from far to near, cycles a lenslet; 0 where an edge is not one any more.

        ``lines``: the running sum of a line's picture is the picture of an edge.
        """
        values = np.asarray(picture.to_numpy(), np.float64)
        y, x = picture.grid.axes()
        axis = picture.geometry.axis
        Y = (y - axis[0]) * self._scale * PITCH / self.camera.mla.row_pitch
        X = (x - axis[1]) * self._scale
        found = []
        for n in range(-self.beside, self.beside + 1):
            part = values[np.ix_(np.abs(Y) < BAND - 0.7, np.abs(X - n * GAP) < 2)]
            part = np.cumsum(part, 1) if lines else part
            try:
                edge = slanted_edge(part, pitch=picture.grid.step * self._scale)
                found.append(edge.mtf.at(0.5))
            except ValueError:
                found.append(0.0)
        return np.array(found)


def slanted(
    device: Device,
    ends: tuple[float, float] = (0.13, 0.3),
    *,
    count: tuple[int, int] = (26, 28),
    pixels: int = 31,
) -> Slanted:
    """Hexagonal, lenslets of about f/20, f = 30 mm in 2f-2f for m = 0.2."""
    b = 3.84e-3
    mla = MicrolensArray(
        PITCH, [b / (1 + m) for m in MS], count=count, lattice="hexagonal", fill="full"
    )
    camera = PlenopticCamera.type2(
        focal_length=0.03, mla=mla, wavelength=532e-9, pixels_per_lenslet=pixels, device=device,
        m=MS[0],
    )  # fmt: skip
    return Slanted(camera, ends, count[1] - 4)


def flat(level: float = 0.5) -> Texture:
    return Texture(np.full((1, 1), level))


def edges() -> Texture:
    """Bars with slanted edges along the middle, noise above and below; 32 lenslets a period."""
    n = 32 * FINE
    y, x = (np.indices((n, n)) - n // 2) / FINE
    rough = noise(3, n // 5, finest=0.4, coarsest=1 / 32, contrast=0.25).samples[..., 0]
    rough = gaussian_filter(np.kron(rough, np.ones((5, 5))), FINE / 6, mode="wrap")
    far = np.abs(((x + TILT * y) / GAP + 0.5) % 2 - 1) - 0.5
    bars = 0.2 + 0.6 * np.clip(far * GAP * FINE + 0.5, 0, 1)
    return Texture(np.where(np.abs(y) < BAND, bars, np.clip(rough, 0, 1)), 1 / FINE)
