"""Surfaces of lenslets, their maps and gaps: closed forms, messages, rays, cameras, files."""

import pickle
import warnings

import numpy as np
import pytest

import clplen
from clplen import Field, Grid, MicrolensArray, PlenopticCamera, SamplingError, ShapeError
from clplen.wave import Glass, LensletMap, LensletSurface

LAM = 532e-9
P = 150e-6


def seen(device, array, grid, wavelength=LAM):
    return device.download(array.transmission(grid, wavelength, device)).astype(complex)


# Surfaces


def test_sag_and_slope_against_closed_forms():
    r = np.linspace(0, 0.9e-3, 37)
    sphere = LensletSurface(1e-3, 1.5)
    np.testing.assert_allclose(sphere.sag(r), 1e-3 - np.sqrt(1e-6 - r**2), rtol=1e-12, atol=1e-20)
    paraboloid = LensletSurface(-2e-3, 1.5, conic=-1)
    np.testing.assert_allclose(paraboloid.sag(r), -(r**2) / 4e-3, rtol=1e-14)
    hyperboloid = LensletSurface(1e-3, 1.5, conic=-3.0)  # (z - a)^2/a^2 - r^2/(a R) = 1, a = -R/2
    z = (np.sqrt(1 + 2 * r**2 / 1e-6) - 1) * 1e-3 / 2
    np.testing.assert_allclose(hyperboloid.sag(r), z, rtol=1e-12, atol=1e-20)
    higher = LensletSurface(1e-3, 1.5, conic=-1, aspheric=(2e6, -3e12))
    np.testing.assert_allclose(higher.sag(r), r**2 / 2e-3 + 2e6 * r**4 - 3e12 * r**6, rtol=1e-12)
    for one in (sphere, paraboloid, hyperboloid, higher):
        step = 1e-8
        slope = (one.sag(r[1:-1] + step) - one.sag(r[1:-1] - step)) / (2 * step)
        np.testing.assert_allclose(one.slope(r[1:-1]), slope, rtol=1e-6)
    assert sphere.reach == 1e-3
    assert LensletSurface(1e-3, 1.5, conic=3).reach == pytest.approx(0.5e-3)
    assert paraboloid.reach == hyperboloid.reach == np.inf


def test_the_focal_length_follows_the_wavelength():
    for name in ["N-BK7", "S-LAH79", "polycarbonate"]:
        glass = Glass.named(name)
        surface = LensletSurface(290e-6, name)
        assert surface.focal_length() == pytest.approx(290e-6 / (glass.n_d - 1), rel=1e-14)
        for lam in (486e-9, 656e-9, 1.0e-6):
            assert surface.focal_length(lam) == pytest.approx(290e-6 / (glass.index(lam) - 1))
        assert surface.focal_length(486e-9) < surface.focal_length(656e-9)
        green = LensletSurface(290e-6, glass, design_wavelength=532e-9)
        assert green.focal_length() == surface.focal_length(532e-9)
        array = MicrolensArray(P, count=3, surface=green)
        assert array.focal_length == array.f == green.focal_length()
        assert LensletSurface(290e-6, 1.46).focal_length(1e-6) == pytest.approx(290e-6 / 0.46)


# What contradicts


def test_a_focal_length_must_not_contradict_the_surface():
    surface = LensletSurface(290e-6, "N-BK7")
    f = surface.focal_length()
    near = MicrolensArray(P, f * 1.0049, count=3, surface=surface)
    assert near.focal_length == f
    assert near == MicrolensArray(P, f=f, count=3, surface=surface)
    for wrong in (f * 1.0051, f * 0.99, -f, 600e-6):
        with pytest.raises(ValueError, match=r"has the focal length 0.000561145 m, not") as error:
            MicrolensArray(P, wrong, count=3, surface=surface)
        said = str(error.value)
        assert "set focal_length=0.000561145, omit it, or use the radius" in said
        radius = float(said.split("the radius ")[1].split()[0])
        again = LensletSurface(radius, "N-BK7")
        assert again.focal_length() == pytest.approx(wrong, rel=1e-5)
    with pytest.raises(ValueError, match="1 surfaces and 2 focal lengths"):
        MicrolensArray(P, (f, 2 * f), count=3, surface=surface)
    with pytest.raises(ValueError, match="require a focal_length in metres, or a surface"):
        MicrolensArray(P, count=3)
    with pytest.raises(TypeError, match="surface must be a LensletSurface"):
        MicrolensArray(P, count=3, surface=[1e-3])


def test_a_surface_must_not_end_within_a_lenslet():
    for lay, far in [
        ({"fill": "circular"}, 75e-6),
        ({"fill": "full"}, 106.1e-6),
        ({"fill": "full", "lattice": "hexagonal"}, 86.6e-6),
    ]:
        MicrolensArray(P, count=2, surface=LensletSurface(far * 1.01, 1.5), **lay)
        with pytest.raises(ValueError, match=r"ends .* m from its vertex, within a lenslet"):
            MicrolensArray(P, count=2, surface=LensletSurface(far * 0.99, 1.5), **lay)


def test_bad_surfaces():
    for arguments, more, message in [
        ((0, 1.5), {}, "radius of a surface must not be 0"),
        ((np.nan, 1.5), {}, "radius of a surface must be finite"),
        (("1", 1.5), {}, "radius of a surface must be a number"),
        ((290, 1.5), {}, "radius of a surface must be in metres.*did you mean 0.29"),
        ((1e-3, 1), {}, "index of a surface must be above 0 and not 1"),
        ((1e-3, -1.5), {}, "index of a surface must be above 0 and not 1"),
        ((1e-3, None), {}, "glass of a surface, if not a Glass or its name, must be"),
        ((1e-3, "BK7"), {}, "no glass 'BK7'.*Did you mean N-BK7"),
        ((1e-3, 1.5), {"conic": np.inf}, "conic constant of a surface must be finite"),
        (
            (1e-3, 1.5),
            {"aspheric": (1, None)},
            "aspheric coefficient of a surface must be a number",
        ),
        ((1e-3, 1.5), {"design_wavelength": 550}, "did you mean 5.5e-07"),
        ((1e-3, "N-BK7"), {"design_wavelength": 550}, "did you mean 5.5e-07"),
        ((1e-3, "N-BK7"), {"design_wavelength": 3e-6}, "within 300 nm to 2.5 um"),
        (
            (1e-3, 1.5),
            {"design_wavelength": -1e-6},
            "design wavelength of a surface must be positive",
        ),
    ]:
        with pytest.raises(ValueError, match=message):
            LensletSurface(*arguments, **more)


def test_steep_surfaces_are_sampled(device):
    """The rim of a sphere is steeper than its focal length says."""
    grid, half = Grid((64, 64), 1e-6), 40e-6
    limit = LAM / 2e-6
    sphere = LensletSurface(130e-6, 1.7)
    paraboloid = LensletSurface(130e-6, 1.7, conic=-1)
    slope = 0.7 * half / np.sqrt((130e-6) ** 2 - half**2)
    array = MicrolensArray(80e-6, count=1, surface=sphere)
    assert array.steepest_slope(LAM) == pytest.approx(slope, rel=1e-12)
    flat = MicrolensArray(80e-6, count=1, surface=paraboloid)
    assert flat.steepest_slope(LAM) == pytest.approx(0.7 * half / 130e-6, rel=1e-12)
    assert flat.steepest_slope(LAM) < limit
    light = Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)
    flat.apply(light)
    array.apply(light)
    steeper = LensletSurface(109e-6, 1.7)
    assert 0.7 * half / 109e-6 < limit < 0.7 * half / np.sqrt((109e-6) ** 2 - half**2)
    wide = Field.from_array(
        np.ones((128, 128)), Grid((128, 128), 1e-6), wavelength=LAM, device=device
    )
    with pytest.raises(SamplingError, match="R_max"):
        MicrolensArray(80e-6, count=1, surface=steeper).apply(wide)


# Gaps


def test_bad_gaps():
    for more, message in [
        ({"gap": "open"}, "gap must be 'opaque' or 'clear', got 'open'"),
        ({"gap": "clear", "fill": "full"}, "gap='clear' requires round lenslets"),
    ]:
        with pytest.raises(ValueError, match=message):
            MicrolensArray(P, 1e-2, count=2, **more)


# Maps


def test_maps_are_told_apart(device):
    values = 1e-7 * np.random.default_rng(5).random((9, 9))
    one, same = (LensletMap(values, pitch=20e-6, glass="N-BK7") for _ in range(2))
    assert one == same
    assert hash(one) == hash(same)
    assert pickle.loads(pickle.dumps(one)) == one
    changed = values.copy()
    changed[4, 4] *= 1 + 1e-12
    others = [
        LensletMap(changed, pitch=20e-6, glass="N-BK7"),
        LensletMap(values, pitch=(20e-6, 20.001e-6), glass="N-BK7"),
        LensletMap(values, pitch=20e-6, glass="F2"),
        LensletMap(values, pitch=20e-6, glass=1.5),
        LensletMap(values, pitch=20e-6, glass="N-BK7", origin=(0, 1e-6)),
        LensletMap(values, pitch=20e-6, glass="N-BK7", complete=True),
    ]
    assert len({one, *others}) == 7
    values[:] = 0
    assert one == same  # maps keep their own copy
    assert MicrolensArray(P, 1e-2, count=2, map=one) == MicrolensArray(P, 1e-2, count=2, map=same)


GOOD = np.zeros((9, 9))


def test_bad_maps():
    for arguments, more, error, message in [
        ((), {"pitch": 2e-5}, ValueError, "either sag= or phase="),
        ((GOOD,), {"phase": GOOD, "pitch": 2e-5}, ValueError, "either sag= or phase="),
        ((GOOD,), {"pitch": 2e-5}, ValueError, "map of sag requires glass="),
        ((), {"phase": GOOD, "pitch": 2e-5}, ValueError, "phase requires wavelength="),
        ((GOOD[:3],), {"pitch": 2e-5, "glass": 1.5}, ShapeError, r"at least 4 .* got \(3, 9\)"),
        ((GOOD[0],), {"pitch": 2e-5, "glass": 1.5}, ShapeError, r"got \(9,\)"),
        ((GOOD[None],), {"pitch": 2e-5, "glass": 1.5}, ShapeError, r"got \(1, 9, 9\)"),
        (
            (np.where(np.arange(81).reshape(9, 9) % 40 == 31, np.nan, 0),),
            {"pitch": 2e-5, "glass": 1.5},
            ValueError,
            r"2 values that are NaN or infinite, the first at \(3, 4\)",
        ),
        ((GOOD + 1j,), {"pitch": 2e-5, "glass": 1.5}, TypeError, "real numbers"),
        ((GOOD,), {"pitch": 0, "glass": 1.5}, ValueError, "pitch of a map must be positive"),
        ((GOOD,), {"pitch": 20, "glass": 1.5}, ValueError, "pitch of a map must be in metres"),
        (
            (np.eye(9),),
            {"pitch": 2e-5, "glass": 1.5},
            ValueError,
            "range of a map of sag must be in metres, .*did you mean 1e-06",
        ),
        (
            (GOOD,),
            {"pitch": 2e-5, "glass": 1},
            ValueError,
            "index of a map must be above 0 and not 1",
        ),
        ((GOOD,), {"pitch": 2e-5, "glass": 1.5, "origin": 0}, ValueError, "origin of a map"),
        (
            (),
            {"phase": GOOD, "pitch": 2e-5, "wavelength": 550},
            ValueError,
            "wavelength of a map .*did you mean 5.5e-07",
        ),
    ]:
        with pytest.raises(error, match=message):
            LensletMap(*arguments, **more)


def test_maps_that_do_not_fit(device):
    small = LensletMap(GOOD, pitch=15e-6, glass=1.5)
    with pytest.raises(
        ValueError, match=r"9 samples of 1.5e-05 m along y .* -6.75e-05 to 6.75e-05"
    ):
        MicrolensArray(P, 1e-2, count=2, map=small)
    MicrolensArray(P, 1e-2, count=2, map=small, diameter=134e-6)
    even = LensletMap(np.zeros((8, 8)), pitch=20e-6, glass=1.5)
    with pytest.raises(ValueError, match="set origin= for sample 4"):
        MicrolensArray(P, 1e-2, count=2, map=even)
    centred = LensletMap(np.zeros((8, 8)), pitch=20e-6, glass=1.5, origin=(10e-6, 10e-6))
    MicrolensArray(P, 1e-2, count=2, map=centred)
    flat = LensletMap(GOOD, pitch=17e-6, glass=1.5)
    MicrolensArray(P, 1e-2, count=2, map=flat, fill="full")
    with pytest.raises(ValueError, match="along y"):  # a hexagon is taller than wide
        MicrolensArray(P, 1e-2, count=2, map=flat, fill="full", lattice="hexagonal")
    each = LensletMap(np.zeros((2, 3, 9, 9)), pitch=20e-6, glass=1.5)
    with pytest.raises(ShapeError, match=r"\(3, 2\), got \(2, 3\)"):
        MicrolensArray(P, 1e-2, count=(3, 2), map=each)
    whole = LensletMap(GOOD, pitch=20e-6, glass=1.5, complete=True)
    for more in ({"surface": LensletSurface(5e-3, 1.5)}, {"focal_length": 1e-2, "gap": "clear"}):
        with pytest.raises(ValueError, match="complete=True replaces"):
            MicrolensArray(P, count=2, map=whole, **more)
    with pytest.raises(TypeError, match="map must be a LensletMap, got ndarray"):
        MicrolensArray(P, 1e-2, count=2, map=GOOD)


# Rays and cameras


def test_rays_are_bent_by_the_gradient_of_the_path(precise):
    """Slopes against differences of the phase that light has."""
    for lattice in ["square", "hexagonal"]:
        random = np.random.default_rng(6)
        surfaces = [
            LensletSurface(r, "N-BK7", conic=-0.4, aspheric=(1e9,)) for r in (3e-3, 4e-3, 5e-3)
        ]
        maps = LensletMap(1e-7 * random.normal(size=(2, 2, 9, 9)), pitch=22e-6, glass=1.4,
                          origin=(1e-6, 0))  # fmt: skip
        array = MicrolensArray(P, count=2, lattice=lattice, surface=surfaces, map=maps, fill="full")
        centres = array.centres().reshape(-1, 2)
        step = 1e-9
        for k, centre in enumerate(centres):
            y, x = random.uniform(-55e-6, 55e-6, (2, 20))
            got = array.bend(np.full(20, k), y, x, LAM)
            for j in range(20):
                for axis in (0, 1):
                    shape = (2, 1) if axis == 0 else (1, 2)
                    at = [centre[0] + y[j], centre[1] + x[j]]
                    at[axis] += step / 2
                    t = seen(precise, array, Grid(shape, step, origin=tuple(at)))
                    slope = np.angle(t.ravel()[1] / t.ravel()[0]) / (2 * np.pi) * LAM / step
                    assert got[axis][j] == pytest.approx(slope, abs=2e-6)


def camera(device, mla, wavelength=LAM):
    return PlenopticCamera.type1(
        focal_length=0.05, mla=mla, wavelength=wavelength, pixels_per_lenslet=24, device=device,
        aperture_diameter=0.4e-3,
    )  # fmt: skip


def test_cameras_see_surfaces_by_waves_and_by_rays(device):
    """The sub-image of a point in focus, by an asphere, against rays; defocused where it is not."""
    surface = LensletSurface(2.6e-3, "N-BK7", conic=-1)
    mla = MicrolensArray(P, count=5, surface=surface, fill="full")
    made = camera(device, mla, surface.design_wavelength)
    thin = camera(
        device, MicrolensArray(P, mla.focal_length, count=5, fill="full"), made.wavelength
    )
    scene = clplen.PointSources([(0, 0, 0)])
    for model in ("waves", "rays"):
        got, expected = (
            c.expose(scene, model=model).to_numpy().astype(float) for c in (made, thin)
        )
        assert np.abs(got - expected).max() <= 1e-4 * expected.max()
    tilted = LensletMap(0.02 * 22e-6 * np.arange(-4, 5) * np.ones((9, 1)), pitch=22e-6, glass=1.5)
    moved = camera(device, MicrolensArray(P, mla.focal_length, count=5, fill="full", map=tilted),
                   made.wavelength)  # fmt: skip
    shift = -0.5 * 0.02 * mla.focal_length
    for model in ("waves", "rays"):
        places = []
        for one in (thin, moved):
            image = one.expose(scene, model=model).to_numpy().astype(float)
            x = (np.arange(image.shape[1]) - image.shape[1] // 2) * one.pixel_pitch
            places.append(image.sum(axis=0) @ x / image.sum())
        assert places[1] - places[0] == pytest.approx(shift, rel=0.1)


def test_surfaces_are_kept_in_files(device, tmp_path):
    surface = LensletSurface(2.6e-3, "N-BK7", conic=-0.3, aspheric=(1e5, 2e10))
    mla = MicrolensArray(P, count=5, surface=surface, gap="clear")
    raw = camera(device, mla).expose(clplen.PointSources([(0, 0, 0)]))
    lf = clplen.LightField.from_raw(raw)
    for name in ("raw.h5", "views.h5"):
        path = tmp_path / name
        if name == "raw.h5":
            clplen.io.write_raw(path, raw)
            again = clplen.io.read_raw(path, device=device)
        else:
            clplen.io.write_lightfield(path, lf)
            again = clplen.io.read_lightfield(path, device=device)
        assert again.camera.mla == mla
    own = Glass("gel", (1.1,), (0.01,), (0.4e-6, 0.8e-6))
    assert LensletSurface.from_json(LensletSurface(1e-3, own).to_json()) == LensletSurface(
        1e-3, own
    )
    mapped = MicrolensArray(P, 5e-3, count=5, map=LensletMap(GOOD, pitch=20e-6, glass=1.5))
    with pytest.warns(UserWarning, match="cannot store lenslet maps"):
        clplen.io.write_raw(
            tmp_path / "map.h5", camera(device, mapped).expose(clplen.PointSources([(0, 0, 0)]))
        )


def test_where_lenslets_must_be_thin_or_alike(device):
    surface = LensletSurface(2.6e-3, "N-BK7")
    made = camera(device, MicrolensArray(P, count=5, surface=surface))
    scene = clplen.SurfaceScene([clplen.cameras.Plane(0.0)])
    with pytest.raises(ValueError, match="SurfaceScene supports thin lenslets only"):
        made.expose(scene, model="rays")
    each = LensletMap(np.zeros((5, 5, 9, 9)), pitch=20e-6, glass=1.5)
    with pytest.raises(ValueError, match="Lenslets of a microscope must be equal"):
        PlenopticCamera.microscope(
            magnification=20, na=0.5, mla=MicrolensArray(P, 3e-3, count=5, map=each),
            wavelength=LAM, pixels_per_lenslet=25, device=device,
        )  # fmt: skip
    several = camera(device, MicrolensArray(P, 5e-3, count=5, map=each))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", clplen.SamplingWarning)
        with pytest.raises(ValueError, match="each has its own map"):
            several.expose(clplen.PicturePlane(np.eye(3), 1e-4), method="isoplanatic")


def test_clear_gaps_let_rays_pass(device):
    """What opaque gaps take of the light is their share of the blur on the array."""
    surface = LensletSurface(2.6e-3, "N-BK7", conic=-1)
    scene = clplen.PointSources([(0, 0, -45e-3)])
    lay = {"count": 5, "surface": surface, "diameter": 100e-6}
    made = {gap: camera(device, MicrolensArray(P, gap=gap, **lay)) for gap in ("opaque", "clear")}
    sums = {gap: one.expose(scene, model="rays").to_numpy().sum() for gap, one in made.items()}
    blur = 0.2e-3 * abs(1 - made["clear"].alpha(-45e-3))
    y, x = np.meshgrid(*[np.linspace(-blur, blur, 801)] * 2, indexing="ij")
    lit = np.hypot((y + P / 2) % P - P / 2, (x + P / 2) % P - P / 2) < 50e-6
    share = lit[np.hypot(y, x) < blur].mean()
    assert 0.3 < share < 0.6
    assert sums["opaque"] / sums["clear"] == pytest.approx(share, rel=0.01)
    assert sums["clear"] == pytest.approx(1, rel=1e-3)
    bare = camera(device, MicrolensArray(P, gap="clear", **(lay | {"diameter": 1e-9})))
    image = bare.expose(scene, model="rays").to_numpy()
    y, x = np.meshgrid(bare.grid.y, bare.grid.x, indexing="ij")
    # unbent, light goes on towards its image: blur (1 - alpha z3/...) of a disc
    far = np.hypot(y, x)[image > 0].max()
    z2, z3 = bare.image_distance, bare.sensor_distance
    alpha = bare.alpha(-45e-3)
    assert far == pytest.approx(0.2e-3 * abs(1 - alpha * (z2 + z3) / z2), rel=0.06)
