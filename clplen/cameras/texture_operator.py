"""Linear map from the textures of a scene to a raw image by rays, with its adjoint."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.camera_base import Plenoptic
from clplen.cameras.exposure.surface_rays import SurfaceRays
from clplen.cameras.scenes.surface_scene import SurfaceScene
from clplen.cameras.scenes.textures import Texture, spline_coefficients
from clplen.checks import require
from clplen.compute.device import Device
from clplen.compute.linear_map import ArrayMap

Values = np.ndarray[Any, Any]


class TextureOperator(ArrayMap):
    """Linear map from samples of textures to the raw image by rays, with its adjoint.

    Visibility does not depend on textures, so that the raw image is linear in their samples. The
    forward map is ``camera.expose(scene, model="rays")`` without background and spots. The operator
    is a `LinearMap`.

    Parameters
    ----------
    camera : Plenoptic1 or Plenoptic2
        Camera built by `PlenopticCamera.type1` or `PlenopticCamera.type2`.
    scene : SurfaceScene
        Scene whose textures define the positions of the samples; surfaces may share a texture.

    Attributes
    ----------
    camera, scene
        Arguments of the constructor.
    textures : tuple of Texture
        Distinct textures in the order of the surfaces.
    device : Device
        Device of the camera.
    in_shape : tuple of int
        (ny, nx, channels) of a single texture; of several the number of all samples, concatenated.
    out_shape : tuple of int
        (ny, nx) of the sensor.
    dtype : numpy.dtype
        Data type of input and output, float32.

    Raises
    ------
    ValueError
        If ``expose`` by rays would raise.
    TypeError
        If the camera or the scene has another type.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5),
    ...     wavelength=532e-9, pixels_per_lenslet=15, aperture_diameter=0.5e-3)
    >>> wall = clplen.cameras.Plane(0.1, texture=clplen.cameras.noise(1, 8))
    >>> operator = clplen.cameras.TextureOperator(camera, clplen.SurfaceScene(wall))
    >>> operator
    <TextureOperator of (8, 8, 1) to (75, 75), ...>
    >>> raw = operator.forward(wall.texture.samples)
    >>> operator.adjoint(raw).shape
    (8, 8, 1)
    """

    def __init__(self, camera: Plenoptic, scene: SurfaceScene) -> None:
        require(Plenoptic, camera, "camera", "PlenopticCamera.type1")
        require(SurfaceScene, scene, "scene", "SurfaceScene")
        self.camera, self.scene = camera, scene
        unique = {id(surface.texture): surface.texture for surface in scene.surfaces}
        self.textures: tuple[Texture, ...] = tuple(unique.values())
        self.device: Device = camera.device
        surface = self.textures[0].samples.shape if len(self.textures) == 1 else None
        self.in_shape: tuple[int, ...] = surface or (sum(t.samples.size for t in self.textures),)
        self.out_shape: tuple[int, ...] = camera.grid.shape
        self.dtype: np.dtype[Any] = np.dtype(np.float32)
        self._rays: SurfaceRays | None = None
        self._rays_ready()

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without tables on the device, which are computed again on demand."""
        return self.__dict__ | {"_rays": None}

    def __repr__(self) -> str:
        return f"<TextureOperator of {self.in_shape} to {self.out_shape}, {self.device.name}>"

    def forward_data(self, data: cla.Array) -> cla.Array:
        """Apply `forward` to arrays of the device."""
        leading = data.shape[: data.ndim - len(self.in_shape)]
        device, channels = self.device, self.scene.channels
        values = device.download(data).reshape(-1, sum(t.samples.size for t in self.textures))
        images = np.empty((len(values), *self.out_shape), np.float32)
        raw = device.empty(self.out_shape, np.float32)
        for image, samples in zip(images, values, strict=True):
            texels, first = [], 0
            for texture in self.textures:
                texture_samples = samples[first : first + texture.samples.size]
                splines = spline_coefficients(texture_samples.reshape(texture.samples.shape))
                texels.append(np.broadcast_to(splines, (*splines.shape[:2], channels)).ravel())
                first += texture.samples.size
            coefficients = device.upload(np.concatenate(texels).astype(np.float32))
            self._rays_ready().expose(raw, coefficients)
            image[:] = device.download(raw)
        return device.upload(images.reshape(*leading, *self.out_shape))

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """Apply `adjoint` to arrays of the device."""
        device, channels = self.device, self.scene.channels
        images = device.download(data).reshape(-1, *self.out_shape)
        sizes = [t.samples.shape[0] * t.samples.shape[1] * channels for t in self.textures]
        gradients = []
        for image in images:
            parts = np.split(self._rays_ready().adjoint(image), np.cumsum(sizes)[:-1])
            for texture, part in zip(self.textures, parts, strict=True):
                ny, nx, own_channels = texture.samples.shape
                spread = spline_coefficients(part.reshape(ny, nx, channels))
                counts = spread if own_channels == channels else spread.sum(axis=2, keepdims=True)
                gradients.append(counts.ravel())
        values = np.concatenate(gradients) if gradients else np.zeros(0)
        return device.upload(values.astype(np.float32).reshape(*data.shape[:-2], *self.in_shape))

    def _rays_ready(self) -> SurfaceRays:
        """Return the rays with their tables on the device."""
        if self._rays is None:
            unlit = SurfaceScene([replace(surface, spots=()) for surface in self.scene.surfaces])
            self._rays = SurfaceRays.of(self.camera.optics, unlit)
        return self._rays
