"""Commented example files: a camera, a pair of cameras to compare, a microscope."""

from __future__ import annotations

EXAMPLE = """\
# A plenoptic camera, a scene and a sensor: clplen simulate camera.toml -o OUT
# A key that begins with # shows its default; a table that begins with # is left out.

[camera]
# kind = "plenoptic1"           # the array on the main image; or "plenoptic2", a focused camera;
                                # or "microscope", without focal length, distances and aperture
focal_length_mm = 120.0         # main lens
wavelength_nm = 532.0
pixels_per_lenslet = 30         # may be fractional; not needed with pitch_um of [camera.pixels]
# lens_model = "auto"           # "thin", a quadratic phase, or "corrected", without aberrations of
                                # its own, as fast lenses are; "auto": by how fast the lens is
# object_distance_mm = 240.0    # to the focused plane; default: twice the focal length, or by
# image_distance_mm = 240.0     # the lens law from the other one; main lens to its image, where
                                # the microlens array of a plenoptic1 lies
# aperture_diameter_mm = 3.6    # default: f-number matched to the lenslets
# field_lens = false            # of a plenoptic1: a lens at the array that centres every sub-image
# m = 0.2                       # needed by a plenoptic2, b/a, < 0: array before the image; or
# a_mm = 60.0                   # needed by a plenoptic2 without m, from the main image to the array
# match = "pupil"               # of a plenoptic2, the aperture's: its image, or a lenslet's "cone",
                                # fills a cell
# magnification = 20.0          # needed by a microscope, of objective and tube lens
# na = 0.5                      # needed by a microscope
# medium_index = 1.0            # of a microscope: air; water 1.33, oil 1.52
# tube_lens_mm = 200.0          # of a microscope
# apodisation = 0.5             # of a microscope, power of cos(theta) over the pupil; -0.5 where
                                # points shine alike in all directions
# cover = { thickness_um = 150 }  # default: none. Of a microscope, a cover glass unlike that which
                                # the objective is made for; index and designed_index are 1.5255,
                                # designed_thickness_um is 170 unless they are given too
# pupil_nm = { 6 = 30.0, 11 = -40.0 }  # default: none. Aberrations of a microscope: Noll's index to
                                # nm of path, rms over the pupil

[camera.microlenses]
pitch_um = 150.0
focal_length_mm = 10.0          # of a plenoptic1 also the distance from the array to the sensor;
                                # several, [10.0, 11.0], make a multi-focus plenoptic2
count = 101                     # or [rows, columns]
fill = "square"                 # or "circular" (default); "full": a cell of any lattice
# lattice = "square"            # or "hexagonal"
# diameter_um = 150.0           # default: the pitch
# offset_um = [0.0, 0.0]        # y, x
# rotation_deg = 0.0            # positive turns +x towards +y (y down)

# [camera.pixels]               # pixels that integrate; else each takes the intensity in its middle
# pitch_um = 5.0                # default: that of the microlenses over pixels_per_lenslet
# fill_factor = 1.0             # active share of a pixel's area
# shape = [3030, 3030]          # rows, columns; default: as many as cover the microlenses
# offset_um = [0.0, 0.0]        # y, x of the sensor's middle from the optical axis
# rotation_deg = 0.0            # of the pixels against the microlenses
# crosstalk = [[0.0, 0.02, 0.0], [0.02, 0.92, 0.02], [0.0, 0.02, 0.0]]  # default: none. Shares of
                                # a pixel's signal that it and its neighbours read
# filters = "RGGB"              # default: none. Colour filters of the pixels (0, 0), (0, 1), (1, 0)
                                # and (1, 1), those of a Nikon D5100; or "GRBG", "GBRG", "BGGR";
                                # "quad RGGB" and so on, two by two pixels each; or "monochrome"

# [camera.aberrations]          # wavefronts: waves at wavelength_nm, rms on a disc, by Noll's index
# main_lens_waves = { 6 = 0.1, 8 = -0.05 }              # default: none
# main_lens_field_waves_per_mm = { 7 = [0.1, 0.0] }     # default: none. Added for each mm of the
                                # image from the axis, along Y and along X
# lenslets_waves = { 11 = 0.05 }                        # default: none. Of every lenslet
# lenslet_circle_um = 212.2     # needed with fill = "square": the disc, about a lenslet's corners
# focal_length_scatter = 0.0    # rms of what differs from lenslet to lenslet: f over its design - 1
# tilt_scatter_mrad = 0.0       # slopes that lenslets add to rays, each axis
# position_scatter_um = 0.0     # vertices from the centres of their apertures, each axis
# scatter_seed = 0
# sensor_shift_um = 0.0         # by how much farther from the array the sensor lies
# sensor_tilt_mrad = [0.0, 0.0] # by how much farther a millimetre along Y and along X, in um

[scene]
# x, y, z of each point: from the axis point of the focused plane, z > 0 farther from the lens
points_mm = [[-3.0, -3.0, -50.0], [0.0, 0.0, 0.0], [3.0, 3.0, 50.0]]
diameter_um = 10.0              # of each source, a coherent disc; 0 (default): a point
# power = 1.0                   # energy through the aperture; one number, or one for each point

# [[scene.pictures]]            # a flat picture; several such tables add up; with pictures a scene
                                # needs no points
# file = "picture.png"          # needed; as seen from the folder of this file. Values are linear,
                                # whole numbers over the largest of their type (8 bits: 255);
                                # colours become grey, .2126 R + .7152 G + .0722 B
# width_mm = 5.0                # needed; of the whole picture; row 0 lies at the smallest y
# z_mm = 0.0
# mode = "emission"             # each sample shines by itself, with its value as energy through
                                # the aperture; or "transmission", a slide of that transmittance
# srgb = false                  # true: decode 8-bit values to linear light
# opacity_file = "opacity.png"  # default: it hides nothing. A picture of as many samples: the share
                                # of the light from behind that each stops, white all of it

# [coherence]                   # the light that falls on slides; its spectrum is the scene's
# spatial = "coherent"          # a plane wave; or "mask", "source" or "incoherent"
# cell_um = 50.0                # needed by a mask of random phase, of each of its cells; or [y, x]
# kernel = "square"             # of a mask; or "gaussian"
# kind = "field"                # of a mask; or "phase"
# source_size_mm = 1.0          # needed by a source, diameter of its disc
# source_distance_mm = 100.0    # needed by a source, from there to the slide
# fwhm_nm = 30.0                # Gaussian about wavelength_nm; default: one wavelength
# spectrum = "white-led"        # or "mercury", "A", "D65", "E"; default: as fwhm_nm says
# spectrum_file = "lamp.csv"    # two columns, wavelengths and power; default: as fwhm_nm says
# lines_nm = [546.2, 577.1]     # default: as fwhm_nm says
# line_powers = [1.0, 1.0]      # default: all the same
# wavelengths = 9               # taken from a spectrum, or 41 from a tabulated one; with filters
                                # as many as the image of a point needs
# seed = 0
# snapshots = 100               # averaged, but for a plane wave; with rtol at most, then 100000
# rtol = 0.01                   # standard error over mean that is enough; default: none
# koehler = true                # the light converges on the main lens

[sensor]                        # without it energies, no noise
# exposure_electrons = 1e6      # for the energy 1; default: energies. All below need it
# shot_noise = false
# read_noise_electrons = 0.0
# full_well_electrons = 20000.0 # default: no saturation
# bit_depth = 12                # up to full_well_electrons; default: values are not rounded
# seed = 0
# prnu = 0.01                   # default: 0. Deviation of the pixels' sensitivities, relative
# dark_current_electrons_per_s = 0.5  # default: 0
# exposure_time_s = 0.02        # default: 0. Of the dark current
# black_level = 64.0            # default: 0. Number of a dark pixel; it and what follows need
                                # bit_depth
# white_level = 4095.0          # default: the largest number of bit_depth
# gain = 1.0                    # or, behind filters, { R = 2.0, G = 1.0, B = 1.6 }
"""

MICROSCOPE = """\
# A light-field microscope, by the names of LFAnalyze and napari-LF:
# clplen microscope psf guv.toml -o psf.h5
# The giant vesicle that comes with napari-LF. A key that begins with # shows its default.

magnification = 60.0            # of objective and tube lens
na = 1.2                        # numerical aperture
medium_index = 1.35             # of what the specimen lies in: air 1, water 1.33, oil 1.52
wavelength = 593.0              # nm, in vacuum, of the fluorescence
tubelens_focal_length = 200.0   # mm; for the table of lengths only
ulens_pitch = 100.0             # um, of the lenslets
ulens_focal_length = 2500.0     # um, array to sensor
pixel_size = 6.5                # um, on the sensor; with a relay between array and sensor divide it
                                # by the relay's magnification
# apodisation = 0.5             # power of cos(theta) over the pupil; -0.5 where points shine alike
                                # in all directions
# cover = { thickness_um = 150 }  # default: none. A cover glass unlike that which the objective is
                                # made for; index and designed_index are 1.5255,
                                # designed_thickness_um is 170 unless they are given too
# pupil_nm = { 6 = 30.0, 11 = -40.0 }  # default: none. Aberrations: Noll's index to nm of path, rms
                                # over the pupil; 'clplen microscope pupil' finds them

# The volume. An even number of planes about the native one, z = 0, leaves out z = 0 itself, where a
# lenslet sees all of its voxels alike. --planes-um START:STOP:N tells them too.
num_slices = 20
um_per_slice = 2.0              # z from -19 to 19 um, farther from the objective positive
supersample = 5                 # voxels of a lenslet along an axis, default 5; or --voxels
"""


_PAIR = """\
# {title}
# clplen analyse standard.toml focused.toml -o compared

[camera]
{kind}
focal_length_mm = 120.0         # main lens, 2f in front of it and 2f behind
aperture_diameter_mm = 10.75    # of both: the focused camera's pupil fills its sub-images
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
        "A standard plenoptic camera (1.0): the array on the main lens' image",
        'kind = "plenoptic1"',
    ),
    "focused": (
        "A focused plenoptic camera (2.0): the array 18 mm behind the main lens' image",
        'kind = "plenoptic2"\nm = 0.2                         # a lenslet\'s b/a: a = 18 mm, '
        "b = 3.6 mm",
    ),
}
_SEPARATIONS = (0.06, 0.1, 0.16, 0.24, 0.36)  # mm
_APART = 0.55  # mm from pair to pair


def pair() -> dict[str, str]:
    """The camera files "standard" and "focused", by name."""
    rows = []
    for k, separation in enumerate(_SEPARATIONS):
        x = (k - (len(_SEPARATIONS) - 1) / 2) * _APART
        rows += [f"  [{x - separation / 2:.3f}, 0.0, 0.0], [{x + separation / 2:.3f}, 0.0, 0.0],"]
    return {
        name: _PAIR.format(title=title, kind=kind, points="\n".join(rows))
        for name, (title, kind) in _KINDS.items()
    }
