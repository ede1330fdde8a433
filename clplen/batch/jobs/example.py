"""A job file with comments."""

EXAMPLE = """\
# Many light fields, and what is made of each: clplen batch job.toml
# A key that begins with # shows its default; a table that begins with # is left out.
# Names of files are seen from the folder of this file.

output = "results"              # a folder in it for each light field
# formats = ["ome-tiff"]        # of stacks, depth maps and pictures: "ome-tiff", "ome-zarr" or both
# device = "gpu"                # default: the first GPU, else the CPU; a list: one for each worker
# memory = "4 GiB"              # default: half of what is free, shared by the workers; of each
                                # worker, larger light fields are streamed
# workers = 1                   # processes; more than one needs pip install "clplen[batch]"
# certificates = "certificates" # default: none; for workers on several computers, the folder of
                                # 'clplen batch --make-certificates'
# retries = 1                   # of what failed for a reason that may pass, or was lost

# Where light fields come from: any of [[inputs]], [[simulations]] and [[scenes]], several of each

# [[inputs]]                    # your own files, in place of the [[scenes]] below
# files = ["captures/*.h5"]     # needed; * and ** as in a shell; also folders of views
# name = "{stem}"               # of the item; {name}, {parent}, {path} and {index} are known, too

# [inputs.layout]               # how the files are read, as by read_lightfield in Python
# pattern = "view_{v}_{u}.png"  # default: guessed; {i} counts row by row, {n} counts anything
# views = [9, 9]                # default: found out; [rows, columns]
# flip_v = false
# flip_u = false
# swap_uv = false               # before the axes are reversed
# order = "vuyx"                # default: found out; axes of an array or a mosaic
# white = "white.png"           # default: none; the white image of raw images
# dark = "dark.png"             # default: none; their dark frame
# grid = "lattice.json"         # default: found out; the lattice of the lenslets
# allow_missing = false         # true: views may be missing, and get the weight 0
# positions = "names"           # default: a grid; or a CSV with the columns v, u, y, x
# srgb = false                  # true: decode to linear light from 0 to 1
# step = 1.0                    # default: found out; pixels a view of a raw image
# lattice = "rectangular"       # default: found out; or "hexagonal"
# bayer = "RGGB"                # default: none; or "BGGR", "GRBG" or "GBRG"
# demosaic = "after"            # default: after; or "before" slicing
# devignette = true             # default: where there is a white image
# dataset = "LF"                # default: found out; of a file that holds several arrays
# max_bytes = "2 GiB"           # default: half of the free memory; that a file may ask for
# force = false                 # true: a white image will do whose lattice is not to be trusted

# [[simulations]]               # light fields of a camera file
# camera = "camera.toml"        # needed; 'clplen simulate --example' prints one
# name = "depths"               # default: the camera file's without suffix

# [[simulations.sweep]]         # one item for each combination of all sweeps of this table
# key = "scene.points_mm.*.2"   # needed; of the camera file. Numbers count entries from 0, * is all
# values = [-100, -50, 0, 50]   # needed
# name = "dz_mm"                # default: the key's last word that is no number; in items' names

[[scenes]]                      # scenes whose depth is known exactly
kind = ["bars", "spheres"]      # needed; "all", or any of: plane, slant, layers, roof, valley,
                                # staircase, spheres, bars, backgammon, dots, stripes, pyramids,
                                # room, glossy, clutter
# name = "set"                  # default: none; before kind and seed in items' names
# seeds = [0]                   # other seeds draw other scenes
shape = [128, 128]              # default: [512, 512]; of a view, [y, x]; not with a camera
views = [5, 5]                  # default: [9, 9]; [rows, columns]; not with a camera
# noise = 0.02                  # default: 0, 0.01, 0.02 or 0.05 in turn; fraction of white; not
                                # with a camera
# camera = "camera.toml"        # default: none; through it by rays, without its [scene]

# [[scenes.sweep]]              # keys: shape, views and noise, or those of the camera file
# key = "noise"                 # needed
# values = [0.0, 0.1]           # needed
# name = "noise"                # default: as above

# What is made of each: at least one of the tables below, or nothing but [[simulations]] and
# [[scenes]], whose raw image, light field and truth are always written

[stack]                         # pictures refocused at many planes
disparities = "-2:2:41"         # START:STOP:N or a list, pixels a view step, nearer is larger;
                                # default: planes that suit the light field
# alphas = "0.8:1.2:41"         # default: as disparities say; F/F', where the spacing is known
# aperture = 9                  # default: all; views across, 0.5 of the diameter, or "f/66"
# interpolation = "linear"      # or "nearest", "cubic" or "fourier"

# [depth]                       # disparity, confidence, and alpha and z where they are known
# alphas = "0.65:1.35:33"       # default: as [stack]
# disparities = "-2:2:33"       # default: as [stack]
# cue = "combined"              # default: combined, of a microscope energy; or "correspondence" or
                                # "structure-tensor"

# [all_in_focus]                # sharp everywhere; by the depth map where there is one
# disparities = "-2:2:33"       # default: planes that suit the light field

# [views]                       # single views
# at = [[4, 4], [0, 4]]         # default: the centre; [v, u] from 0, fractions too

# [light_field]                 # as it was decoded
# format = "hdf5"               # or "zarr"

# [deconvolve]                  # the volume behind raw frames of a light-field microscope, whose
                                # white and dark frame [inputs.layout] names
# psf = "psf.h5"                # needed; 'clplen microscope psf' makes it
# iterations = 20               # of Richardson and Lucy
# background = 0.0              # counts of a pixel above the dark frame
# gain = 1.0                    # counts of a photon
# saturation = 65535.0          # default: the largest of an integer type; left out from there on
# haze = false                  # true: white frame, as dark as the darkest lenslets, is none of it
# residual = 0.01               # default: none; stop below it, or "noise", at that of photons
# accelerate = false            # true: fewer iterations, more memory
# prior = "tv"                  # default: none; against noise; "gaussian": about the native plane
# strength = 1.0                # of the prior

# [raw]                         # of simulations and scenes; it has no keys
"""
