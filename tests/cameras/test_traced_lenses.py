"""OPD maps of lenses by their prescriptions, against rays and numbers of optiland."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clplen.cameras import OPDMaps

ROOT = Path(__file__).parents[2]
HAS_OPTILAND = importlib.util.find_spec("optiland") is not None
needs_optiland = pytest.mark.skipif(
    not HAS_OPTILAND, reason="optiland is not installed: pip install 'clplen[lenses]'"
)
pytestmark = pytest.mark.filterwarnings("ignore")  # Numba's, as it compiles optiland
LINE = 587.6e-9


def example(name: str) -> Any:
    """A module of the examples' lenses."""
    folder = str(ROOT / "examples" / "lenses")
    if folder not in sys.path:
        sys.path.append(folder)
    return importlib.import_module(name)


def lens(name: str = "cooke") -> Any:
    return example("prescriptions").LENSES[name].optic()


@needs_optiland
@pytest.mark.parametrize("name", ["cooke", "gauss"])
def test_rays_meet_the_image_where_slopes_send_them(name: str) -> None:
    """The path's slope times the distance is the ray's aberration (Born and Wolf 1999, 5.1).

    On the plane it grows by 1/cos^3 of the chief ray's angle along the field, by 1/cos across.
    """
    optic = lens(name)
    maps = OPDMaps.traced(optic, fields=7, samples=65)
    F, R = maps.pupil_distance, maps.pupil_diameter / 2  # type: ignore[operator]
    v, u = np.array([0.6, 0.2, -0.5, -0.7, 0.0]), np.array([0.1, 0.5, 0.5, 0.0, 0.7])
    for fraction in (0.0, 0.4, 0.85):  # between fields, too
        angle = np.radians([fraction * optic.fields.max_field, optic.fields.max_field])
        y = maps.fields[-1, 0] * np.tan(angle[0]) / np.tan(angle[1])
        rays = optic.trace_generic(0.0, fraction, u, v, LINE * 1e6)
        chief = optic.trace_generic(0.0, fraction, 0.0, 0.0, LINE * 1e6)
        place = float(np.ravel(chief.y)[0]) * 1e-3
        assert maps.chief_ray(y, 0, LINE) == pytest.approx((place, 0), abs=1e-7)
        cosine = float(np.ravel(chief.N)[0])
        down, right = maps.slopes(y, 0, LINE, v, u)
        found = np.stack([down / cosine**3, right / cosine]) * F / R
        exact = np.stack([np.asarray(rays.y) * 1e-3 - place, np.asarray(rays.x) * 1e-3])
        assert np.abs(found - exact).max() <= 0.03 * np.abs(exact).max()
        turned = maps.slopes(0, -y, LINE, u, -v)  # the field along -x
        assert turned[1] == pytest.approx(-down, abs=1e-12)
        assert turned[0] == pytest.approx(right, abs=1e-12)
    far = maps.pupil_centre(maps.fields[-1, 0], 0, LINE)
    assert abs(far[0]) > 0.02  # and there no light is lost by it


@needs_optiland
@pytest.mark.thorough
def test_the_examples_table() -> None:
    """Strehl, distortion and vignetting of one lens at a field and a line between those traced."""
    table = example("compare_lenses")
    optic = lens("cooke")
    maps = OPDMaps.traced(optic, fields=11, wavelengths=(587.6e-9, 480e-9, 656.3e-9, 690e-9))
    y = maps.fields[-1, 0] * np.tan(np.radians(15)) / np.tan(np.radians(20))
    line = 640e-9
    ours, theirs = table.our_strehl(maps, y, line), table.their_strehl(optic, 0.75, line)
    assert ours == pytest.approx(theirs, rel=0.01)
    assert maps.passed(y, 0, line) == pytest.approx(table.their_share(optic, 0.75, line), abs=2e-3)
    assert maps.passed(y, 0, line) < 0.985


@needs_optiland
def test_prescriptions_from_files(tmp_path: Path) -> None:
    from optiland.fileio import save_optiland_file

    optic = lens()
    save_optiland_file(optic, str(tmp_path / "lens.json"))
    words: dict[str, Any] = {"fields": (0.0, 1.0), "wavelengths": [LINE], "samples": 9}
    found, given = (OPDMaps.traced(one, **words) for one in (tmp_path / "lens.json", optic))
    assert np.nanmax(np.abs(found.paths - given.paths)) <= 1e-12
    zemax = "\n".join([
        "VERS 200000 0 0", "MODE SEQ", "NAME singlet", "UNIT MM X W X CM MR CPMM", "ENPD 5.0",
        "ENVD 20 1 0", "GCAT SCHOTT", "FTYP 0 0 2 1 0 0 0", "XFLN 0 0", "YFLN 0 3",
        "WAVM 1 0.5876 1", "PWAV 1",
        "SURF 0", "  TYPE STANDARD", "  CURV 0.0", "  DISZ INFINITY",
        "SURF 1", "  STOP", "  TYPE STANDARD", "  CURV 0.02", "  DISZ 4.0", "  GLAS N-BK7 0 0",
        "SURF 2", "  TYPE STANDARD", "  CURV -0.005", "  DISZ 75.0",
        "SURF 3", "  TYPE STANDARD", "  CURV 0.0", "  DISZ 0.0", "",
    ])  # fmt: skip
    (tmp_path / "singlet.zmx").write_text(zemax, encoding="utf-16")
    single = OPDMaps.traced(tmp_path / "singlet.zmx", fields=2, samples=9)
    assert single.wavelengths == pytest.approx([0.5876e-6])
    assert single.fields[1, 0] == pytest.approx(np.tan(np.radians(3)) * 0.0776, rel=0.03)
    assert np.nanmax(np.abs(single.paths)) > 0.2 * LINE
    with pytest.raises(FileNotFoundError, match="No prescription"):
        OPDMaps.traced(tmp_path / "none.zmx")
    (tmp_path / "lens.len").touch()
    with pytest.raises(ValueError, match=r"\.json or Zemax' \.zmx, got lens\.len"):
        OPDMaps.traced(tmp_path / "lens.len")


@needs_optiland
def test_lenses_that_are_refused() -> None:
    tilted = lens()
    tilted.surfaces[3].geometry.cs.rx = 0.01
    with pytest.raises(ValueError, match="must be rotationally symmetric"):
        OPDMaps.traced(tilted, fields=2, samples=17)
    for words, said in (
        ({"fields": 0}, "a number >= 1"),
        ({"fields": (0, 1.2)}, "fractions of the largest field"),
        ({"samples": 3}, "5 or more"),
        ({"wavelengths": [587.6]}, "did you mean 5.876e-07"),
        ({"wavelengths": [-1e-6]}, "wavelengths must be positive"),
    ):
        with pytest.raises(ValueError, match=said):
            OPDMaps.traced(lens(), **words)  # type: ignore[arg-type]
    with pytest.raises(MemoryError, match="use fewer fields"):
        OPDMaps.traced(lens(), fields=10**5, samples=10**4)
    with pytest.raises(TypeError, match="optiland Optic or a path"):
        OPDMaps.traced(3.0)
    real = lens()
    real.fields.set_type(field_type="real_image_height")
    with pytest.raises(ValueError, match="got RealImageHeightField"):
        OPDMaps.traced(real)


@pytest.mark.skipif(HAS_OPTILAND, reason="optiland is installed")
def test_without_optiland_it_is_named() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"pip install .clplen\[lenses\]"):
        OPDMaps.traced("lens.zmx")
