"""Commented example files: a camera, a pair of cameras for comparison, a microscope."""

from __future__ import annotations

EXAMPLE = """\
# A plenoptic camera, a scene and a sensor: clplen simulate camera.toml -o OUT
# Keys that begin with # show their defaults; tables that begin with # are inactive.

[camera]
# kind = "plenoptic1"           # standard camera; "plenoptic2": focused camera; or "microscope",
                                # without focal length, distances and aperture
focal_length_mm = 120.0         # focal length of the main lens
wavelength_nm = 532.0
pixels_per_lenslet = 30         # may be fractional; optional with pitch_um in [camera.pixels]
# lens_model = "auto"           # "thin": quadratic phase; "corrected": free of aberrations, like
                                # fast camera lenses; "auto": by the f-number
# object_distance_mm = 240.0    # lens to the focused plane; default: twice the focal length, or
# image_distance_mm = 240.0     # by the lens law from the other distance. Lens to the image, where
                                # the microlens array of a plenoptic1 lies
# aperture_diameter_mm = 3.6    # default: f-number matched to the lenslets
# field_lens = false            # plenoptic1: lens at the array that centres every sub-image
# m = 0.2                       # plenoptic2, required unless a_mm is given: b/a, negative if the
                                # array lies in front of the image
# a_mm = 60.0                   # plenoptic2, required unless m is given: image to array
# match = "pupil"               # plenoptic2: aperture for which the image of the pupil ("pupil") or
                                # the cone of a lenslet ("cone") fills a cell
# magnification = 20.0          # microscope, required: magnification of objective and tube lens
# na = 0.5                      # microscope, required: numerical aperture
# medium_index = 1.0            # microscope: refractive index, air 1, water 1.33, oil 1.52
# tube_lens_mm = 200.0          # microscope: focal length of the tube lens
# apodisation = 0.5             # microscope: exponent of cos(theta) over the pupil; -0.5 for points
                                # that radiate equally in all directions
# cover = { thickness_um = 150 }  # microscope, default: none. Cover glass, if it differs from that
                                # of the objective's design. Optional keys: index and
                                # designed_index, 1.5255; designed_thickness_um, 170
# pupil_nm = { 6 = 30.0, 11 = -40.0 }  # microscope, default: none. Aberrations by Noll's index in
                                # nm of optical path, rms over the pupil

[camera.microlenses]
pitch_um = 150.0
focal_length_mm = 10.0          # plenoptic1: also the distance from array to sensor; plenoptic2:
                                # may be a list such as [10.0, 11.0], for several types of lenslets
count = 101                     # number of rows and columns, or [rows, columns]
fill = "square"                 # or "circular" (default), or "full": the cell of any lattice
# lattice = "square"            # or "hexagonal"
# diameter_um = 150.0           # default: the pitch
# offset_um = [0.0, 0.0]        # y, x
# rotation_deg = 0.0            # positive turns +x towards +y (y down)

# [camera.pixels]               # pixels that integrate; without it pixels sample their centres
# pitch_um = 5.0                # default: pitch of the microlenses over pixels_per_lenslet
# fill_factor = 1.0             # light-sensitive fraction of the area of a pixel
# shape = [3030, 3030]          # rows, columns; default: as many as cover the microlenses
# offset_um = [0.0, 0.0]        # y, x of the centre of the sensor from the optical axis
# rotation_deg = 0.0            # rotation of the pixels relative to the microlenses
# crosstalk = [[0.0, 0.02, 0.0], [0.02, 0.92, 0.02], [0.0, 0.02, 0.0]]  # default: none. Fractions
                                # of the signal of a pixel in the pixel and its neighbours
# filters = "RGGB"              # default: none. Colour filters (Nikon D5100) of the pixels (0, 0),
                                # (0, 1), (1, 0) and (1, 1); or "GRBG", "GBRG", "BGGR"; "quad RGGB"
                                # and so on with 2 x 2 pixels each; or "monochrome"

# [camera.aberrations]          # wavefront errors in waves of wavelength_nm, rms, by Noll's index
# main_lens_waves = { 6 = 0.1, 8 = -0.05 }              # default: none
# main_lens_field_waves_per_mm = { 7 = [0.1, 0.0] }     # default: none. Increase per mm of the
                                # image from the axis, along Y and along X
# lenslets_waves = { 11 = 0.05 }                        # default: none. Equal for all lenslets
# lenslet_circle_um = 212.2     # required with fill = "square": diameter of the Zernike disc, which
                                # encloses the corners of a lenslet
# focal_length_scatter = 0.0    # relative rms deviation of the lenslets' focal lengths
# tilt_scatter_mrad = 0.0       # rms slope that lenslets add to rays, along each axis
# position_scatter_um = 0.0     # rms offset of vertices from the centres of apertures, each axis
# scatter_seed = 0
# sensor_shift_um = 0.0         # displacement of the sensor away from the array
# sensor_tilt_mrad = [0.0, 0.0] # tilt of the sensor: um of displacement per mm along Y and along X

[scene]
# x, y, z of each point in mm: z > 0 is farther from the lens than the focused plane
points_mm = [[-3.0, -3.0, -50.0], [0.0, 0.0, 0.0], [3.0, 3.0, 50.0]]
diameter_um = 10.0              # diameter of each source, a coherent disc; 0 (default): a point
# power = 1.0                   # energy through the aperture; a number, or a number per point

# [[scene.pictures]]            # a flat picture; repeat the table for more pictures; points_mm is
                                # optional then
# file = "picture.png"          # required; relative to the folder of this file. Values are linear:
                                # integers over the maximum of their type (8 bits: 255); colours
                                # become grey, 0.2126 R + 0.7152 G + 0.0722 B
# width_mm = 5.0                # required; width of the picture; row 0 lies at the smallest y
# z_mm = 0.0
# mode = "emission"             # samples are light sources, with energies through the aperture; or
                                # "transmission": a slide with this transmittance
# srgb = false                  # true: decode 8-bit values to linear light
# opacity_file = "opacity.png"  # default: transparent to light from behind. Picture of equal size;
                                # white samples block all light from behind

# [coherence]                   # light that falls on slides, and the spectrum of the scene
# spatial = "coherent"          # a plane wave; or "mask", "source" or "incoherent"
# cell_um = 50.0                # required for "mask": cell of the random phase mask, or [y, x]
# kernel = "square"             # "mask": shape of a cell, or "gaussian"
# kind = "field"                # "mask": random field, or "phase"
# source_size_mm = 1.0          # required for "source": diameter of the disc
# source_distance_mm = 100.0    # required for "source": distance from source to slide
# fwhm_nm = 30.0                # Gaussian around wavelength_nm; default: a single wavelength
# spectrum = "white-led"        # or "mercury", "A", "D65", "E"; default: by fwhm_nm
# spectrum_file = "lamp.csv"    # columns wavelength and power; default: by fwhm_nm
# lines_nm = [546.2, 577.1]     # spectral lines; default: by fwhm_nm
# line_powers = [1.0, 1.0]      # default: equal powers
# wavelengths = 9               # number of samples of the spectrum, 41 of a tabulated spectrum;
                                # with filters as many as the image of a point needs
# seed = 0
# snapshots = 100               # number of averaged snapshots, unless "coherent"; the maximum with
                                # rtol, then 100000
# rtol = 0.01                   # target for the standard error relative to the mean; default: none
# koehler = true                # the light converges to the main lens

[sensor]                        # without this table the result is energy without noise
# exposure_electrons = 1e6      # electrons for unit energy; default: energies. Required below
# shot_noise = false
# read_noise_electrons = 0.0
# full_well_electrons = 20000.0 # default: no saturation
# bit_depth = 12                # quantisation up to full_well_electrons; default: no rounding
# seed = 0
# prnu = 0.01                   # relative rms of the pixels' sensitivities; default: 0
# dark_current_electrons_per_s = 0.5  # default: 0
# exposure_time_s = 0.02        # exposure time for the dark current; default: 0
# black_level = 64.0            # count of a dark pixel; default: 0. Needs bit_depth, as do the next
# white_level = 4095.0          # default: the maximum of bit_depth
# gain = 1.0                    # or, with filters, { R = 2.0, G = 1.0, B = 1.6 }
"""

MICROSCOPE = """\
# A light-field microscope with the names of LFAnalyze and napari-LF:
# clplen microscope psf guv.toml -o psf.h5
# Values for the giant vesicle of napari-LF. Keys that begin with # show their defaults.

magnification = 60.0            # magnification of objective and tube lens
na = 1.2                        # numerical aperture
medium_index = 1.35             # refractive index around the specimen: air 1, water 1.33, oil 1.52
wavelength = 593.0              # nm, wavelength of the fluorescence in vacuum
tubelens_focal_length = 200.0   # mm, for the printed lengths only
ulens_pitch = 100.0             # um, pitch of the lenslets
ulens_focal_length = 2500.0     # um, distance from array to sensor
pixel_size = 6.5                # um, on the sensor; with a relay between array and sensor divide it
                                # by the magnification of the relay
# apodisation = 0.5             # exponent of cos(theta) over the pupil; -0.5 for points that
                                # radiate equally in all directions
# cover = { thickness_um = 150 }  # default: none. Cover glass, if it differs from that of the
                                # objective's design. Optional keys: index and designed_index,
                                # 1.5255; designed_thickness_um, 170
# pupil_nm = { 6 = 30.0, 11 = -40.0 }  # default: none. Aberrations by Noll's index in nm of optical
                                # path, rms over the pupil; 'clplen microscope pupil' estimates them

# Volume. An even number of planes, centred on the native plane z = 0, leaves out z = 0, where
# voxels below a lenslet cannot be distinguished. The option --planes-um START:STOP:N replaces it.
num_slices = 20
um_per_slice = 2.0              # z from -19 to 19 um, farther from the objective positive
supersample = 5                 # voxels per lenslet along an axis, default 5; option --voxels
"""


_PAIR = """\
# {title}
# clplen analyse standard.toml focused.toml -o compared

[camera]
{kind}
focal_length_mm = 120.0         # main lens, imaging 2f to 2f
aperture_diameter_mm = 10.75    # sub-images of the focused camera are filled
wavelength_nm = 532.0
pixels_per_lenslet = 30

[camera.microlenses]
pitch_um = 150.0
focal_length_mm = 3.0
count = 101
fill = "square"

[scene]
# pairs of points 0.06, 0.1, 0.16, 0.24 and 0.36 mm apart
points_mm = [
{points}
]
"""
_KINDS = {
    "standard": (
        "A standard plenoptic camera (1.0): array in the image plane of the main lens",
        'kind = "plenoptic1"',
    ),
    "focused": (
        "A focused plenoptic camera (2.0): array 18 mm behind the image plane of the main lens",
        'kind = "plenoptic2"\nm = 0.2                         # b/a of the lenslets: a = 18 mm, '
        "b = 3.6 mm",
    ),
}
_SEPARATIONS = (0.06, 0.1, 0.16, 0.24, 0.36)  # mm
_PAIR_DISTANCE = 0.55  # mm between neighbouring pairs


def pair() -> dict[str, str]:
    """Return the camera files "standard" and "focused", by name."""
    rows = []
    for k, separation in enumerate(_SEPARATIONS):
        x = (k - (len(_SEPARATIONS) - 1) / 2) * _PAIR_DISTANCE
        rows += [f"  [{x - separation / 2:.3f}, 0.0, 0.0], [{x + separation / 2:.3f}, 0.0, 0.0],"]
    return {
        name: _PAIR.format(title=title, kind=kind, points="\n".join(rows))
        for name, (title, kind) in _KINDS.items()
    }
