"""A Fourier light-field microscope as lengths: what follows from its parameters without any wave.

Objective and tube lens make the native image, with the field stop; the relay lens behind it makes
the conjugate pupil, 2 NA f_FL/M wide, where the lenslets lie, and each shows the specimen from its
own angle on the sensor (Llavador, Sola-Pikabea, Saavedra, Javidi and Martinez-Corral 2016,
"Resolution improvements in integral microscopy with Fourier plane recording"; Scrofani et al.
2018, "FIMic"; Guo, Liu, Hua, Wang and Jia 2019, "Fourier light-field microscopy"). The specimen is
upright in every sub-image. A lenslet centred at c sees it along the rays n sin(theta) = -M c/f_FL,
and a point at (x, y, z) lies in its sub-image at c + M_T (x + z tan(theta)), M_T = M s/f_FL.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.cameras.fourier.lenslet_layout import LensletLayout, covered
from clplen.cameras.optics.lenslet_camera import Described, Description, Row
from clplen.cameras.optics.objective import APODISATION, CoverGlass, Objective
from clplen.compute.device import Device, as_device
from clplen.units import metres
from clplen.wave.field.field import Grid

Vector = np.ndarray[Any, Any]

WHOLE = 0.95  # of a lenslet's aperture in the pupil: it counts as a whole one
LIT = 0.02  # of it: a lenslet that has less of the pupil makes no sub-image
SAMPLES = 128  # across a lenslet, by which its share of the pupil is found


@dataclass(frozen=True, repr=False)
class FourierOptics(Described):
    """A Fourier light-field microscope as lengths; `FourierMicroscope` takes its frames.

    Attributes
    ----------
    magnification, na, medium_index, tube_lens : float
        M, NA and n of the objective; focal length of the tube lens in metres.
    relay : float
        f_FL, focal length of the relay (Fourier) lens in metres.
    lenslets : LensletLayout
    sensor_distance : float
        s in metres, from the lenslets to the sensor.
    field_stop : float
        Diameter of the stop on the native image, in metres.
    wavelength : float
        In vacuum, in metres.
    pixel_pitch : float
        In metres.
    grid : Grid
        Of the sensor.
    device : Device
    cover : CoverGlass or None
    apodisation : float
        e, of the amplitude cos(theta)^e over the pupil.
    """

    magnification: float
    na: float
    medium_index: float
    tube_lens: float
    relay: float
    lenslets: LensletLayout
    sensor_distance: float
    field_stop: float
    wavelength: float
    pixel_pitch: float
    grid: Grid
    device: Device
    cover: CoverGlass | None = None
    apodisation: float = APODISATION

    def __post_init__(self) -> None:
        object.__setattr__(self, "device", as_device(self.device))

    def __repr__(self) -> str:
        ny, nx = self.grid.shape
        return (
            f"<{type(self).__name__} {self.magnification:g}x/{self.na:g}, {len(self.lenslets)} "
            f"lenslets of {metres(self.lenslets.diameter)}, {ny} x {nx} pixels, "
            f"{metres(self.wavelength)}, {self.device.name}>"
        )

    @property
    def objective(self) -> Objective:
        """Objective with tube lens."""
        return Objective(
            self.magnification,
            self.na,
            self.medium_index,
            self.wavelength,
            self.cover,
            self.apodisation,
        )

    @property
    def pupil_diameter(self) -> float:
        """2 NA f_FL/M, of the conjugate pupil in metres (Guo et al. 2019)."""
        return 2 * self.na * self.relay / self.magnification

    @property
    def scale(self) -> float:
        """M_T = M s/f_FL, from the specimen to a sub-image (Guo et al. 2019)."""
        return self.magnification * self.sensor_distance / self.relay

    @property
    def side(self) -> float:
        """Of a pixel in the specimen, in metres."""
        return self.pixel_pitch / self.scale

    @property
    def effective_na(self) -> float:
        """M d/(2 f_FL) = NA/N, of one lenslet (Scrofani et al. 2018)."""
        return self.magnification * self.lenslets.diameter / (2 * self.relay)

    @property
    def lit(self) -> Vector:
        """Share of each lenslet's aperture in the pupil, float64, shape (lenslets,)."""
        layout = self.lenslets
        step = 2 * layout.reach / SAMPLES
        t = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) * step
        shape = layout.coverage(t, t, step)
        inside = self.pupil_diameter / 2 - np.hypot(*layout.positions.T)
        found = (inside > 0).astype(np.float64)
        for lenslet in np.flatnonzero(np.abs(inside) < layout.reach + step):
            y, x = layout.positions[lenslet]
            rim = self.pupil_diameter / 2 - np.hypot(y + t[:, None], x + t)
            found[lenslet] = (shape * covered(rim, step)).sum() / shape.sum()
        return found

    @property
    def sine(self) -> float:
        """sin(theta) of the outermost lenslet that has its whole aperture in the pupil; or NaN."""
        whole = self.lenslets.positions[self.lit >= WHOLE]
        if not len(whole):
            return math.nan
        farthest = float(np.hypot(*whole.T).max())
        return self.magnification * farthest / (self.relay * self.medium_index)

    def displacement(self, z: float) -> Vector:
        """M_T z tan(theta) of every sub-image on the sensor, by its lenslet's central ray.

        Parameters
        ----------
        z : float
            In metres, farther positive.

        Returns
        -------
        numpy.ndarray
            (y, x) in metres, float64, shape (lenslets, 2); NaN beyond the pupil.
        """
        sines = -self.magnification * self.lenslets.positions / self.relay  # n sin(theta)
        length = np.hypot(*sines.T)
        inside = np.minimum(length, self.na)
        reach = self.objective.landing(inside, z) * self.sensor_distance / self.relay
        along = sines / np.maximum(length, 1e-300)[:, None]
        return np.asarray(along * reach[:, None])

    @property
    def lateral_resolution(self) -> float:
        """The larger of lam N/(2 NA) and two pixels, in metres (Scrofani et al. 2018)."""
        return max(self.wavelength / (2 * self.effective_na), 2 * self.side)

    @property
    def axial_resolution(self) -> float:
        """Lateral resolution over tan(theta) of the outermost whole lenslet, in metres.

        Two points that far apart on the axis are told apart in its sub-image.
        """
        sine = self.sine
        if not 0 < sine < 1:
            return math.inf if sine == 0 else math.nan
        return self.lateral_resolution * math.sqrt(1 - sine**2) / sine

    @property
    def depth_of_field(self) -> float:
        """n lam N^2/NA^2 + n N pixel/(NA M_T) in metres, whole (Galdon et al. 2022)."""
        na, n = self.effective_na, self.medium_index
        return n * self.wavelength / na**2 + n * self.side / na

    @property
    def sub_image(self) -> float:
        """Diameter of a sub-image on the sensor in metres: of the field stop, times s/f_FL."""
        return self.field_stop * self.sensor_distance / self.relay

    @property
    def overlap(self) -> float:
        """Share of a sub-image's diameter that its neighbour covers, too."""
        return max(0.0, 1 - self.lenslets.spacing / self.sub_image)

    def describe(self) -> Description:
        """Derived parameters; see `Description`."""
        M, n, layout = self.magnification, self.medium_index, self.lenslets
        D, d = self.pupil_diameter, layout.diameter
        ny, nx = self.grid.shape
        kinds = np.unique(layout.focal_lengths)
        sine = self.sine
        angle = math.degrees(math.asin(sine)) if sine < 1 else math.nan
        rows = (
            Row("magnification", M, "", f"tube lens {self.tube_lens * 1e3:g} mm"),
            Row("numerical aperture", self.na, "", f"in a medium of index {n:g}"),
            Row("relay focal length", self.relay, "m", "f_FL, Fourier lens"),
            Row("pupil", D, "m", "2 NA f_FL/M, conjugate, where the lenslets lie"),
            Row("lenslets", len(layout), "", f"{int((self.lit >= LIT).sum())} with light, "
                f"{int((self.lit >= WHOLE).sum())} whole, {layout.fill}"),
            Row("lenslet diameter", d, "m", "d"),
            Row("lenslets across the pupil", D / d, "", "N = D/d (Guo et al. 2019)"),
            Row("lenslet focal length", float(kinds[0]), "m", "f_ML" + ("" if len(kinds) == 1
                else f", the shortest of {len(kinds)}")),
            Row("sensor distance", self.sensor_distance, "m", "s, lenslets to sensor"),
            Row("pixel pitch", self.pixel_pitch, "m", f"sensor {ny} x {nx}"),
            Row("sub-image magnification", self.scale, "", "M_T = M s/f_FL (Guo et al. 2019)"),
            Row("voxel", self.side, "m", "pixel/M_T"),
            Row("field stop", self.field_stop, "m", "diameter, on the native image"),
            Row("field of view", self.field_stop / M, "m", "diameter, in the medium; d f_FL/(f_ML "
                "M) where sub-images touch (Guo et al. 2019)"),
            Row("overlap", self.overlap, "", "of neighbouring sub-images, over their diameter"),
            Row("effective aperture", self.effective_na, "", "NA/N (Scrofani et al. 2018)"),
            Row("lateral resolution", self.lateral_resolution, "m",
                "max(lam N/(2 NA), 2 pixel/M_T) (Scrofani et al. 2018)"),
            Row("largest view angle", angle, "deg", "n sin(theta) = M c/f_FL, outermost whole "
                "lenslet"),
            Row("axial resolution", self.axial_resolution, "m", "lateral over tan(theta) of it"),
            Row("depth of field", self.depth_of_field, "m",
                "n lam N^2/NA^2 + n N pixel/(NA M_T), of one sub-image (Galdon et al. 2022)"),
        )  # fmt: skip
        return Description("Fourier light-field microscope", rows)
