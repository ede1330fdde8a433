"""The cameras by their names."""

from __future__ import annotations

from clplen.cameras import geometry
from clplen.cameras.plenoptic1 import Plenoptic1
from clplen.compute.device import Device, require_device
from clplen.wave.lenslets import MicrolensArray
from clplen.wave.spectra import check_wavelength


class PlenopticCamera:
    """Plenoptic cameras simulated by wave optics; see `type1`."""

    @staticmethod
    def type1(
        *,
        focal_length: float,
        mla: MicrolensArray,
        wavelength: float,
        pixels_per_lenslet: float,
        device: Device,
        object_distance: float | None = None,
        image_distance: float | None = None,
        aperture_diameter: float | None = None,
        field_lens: bool = False,
    ) -> Plenoptic1:
        """A standard plenoptic camera: array on the main lens' image, sensor f_mu behind it.

        Parameters
        ----------
        focal_length : float
            Of the main lens in metres.
        mla : MicrolensArray
            Brings pitch, f_mu, count, lattice, fill, offset and rotation.
        wavelength : float
            In metres.
        pixels_per_lenslet : float
            At least 2; may be fractional.
        device : Device
            Where the simulation runs.
        object_distance, image_distance : float, optional
            Main lens to focused object plane, and to the array, in metres. Neither: 2f and 2f.
            One: the other by the lens law.
        aperture_diameter : float, optional
            Of the main lens in metres; None matches the f-numbers: pitch F/f_mu.
        field_lens : bool
            A lens of focal length F at the array puts the exit pupil at infinity.

        Returns
        -------
        Plenoptic1

        Raises
        ------
        ValueError
            For a length that is not positive, or distances that contradict the lens law.
        SamplingError
            If a lenslet has less than 2 pixels, or the pixels cannot sample the light on the axis.
        """
        require_device(device)
        geometry.require_lengths(
            focal_length=focal_length,
            wavelength=wavelength,
            object_distance=object_distance,
            image_distance=image_distance,
            aperture_diameter=aperture_diameter,
        )
        check_wavelength(wavelength)
        if mla.f <= 0:
            raise ValueError(f"The lenslets of a camera converge: f > 0, not {mla.f!r}.")
        z_obj, F = geometry.lens_law(focal_length, object_distance, image_distance)
        D = mla.pitch * F / mla.f if aperture_diameter is None else aperture_diameter
        grid = geometry.sensor_grid(mla, pixels_per_lenslet)
        camera = Plenoptic1(
            focal_length=float(focal_length),
            object_distance=z_obj,
            image_distance=F,
            aperture_diameter=float(D),
            mla=mla,
            wavelength=float(wavelength),
            pixels_per_lenslet=float(pixels_per_lenslet),
            pixel_pitch=grid.pitch[1],
            grid=grid,
            field_lens=bool(field_lens),
            device=device,
        )
        geometry.check_sampling(camera, 0.0, 1.0)
        return camera
