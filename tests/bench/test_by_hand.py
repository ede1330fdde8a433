"""Forms of refocusing by hand compute what clplen computes, where all views reach."""

from __future__ import annotations

import numpy as np
from peers import by_hand

from clplen.compute.device import Device
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus

DISPARITY = 1.37


def test_every_form_that_is_installed_agrees_with_clplen(device: Device) -> None:
    for shape in ((3, 4, 31, 37, 3), (4, 3, 29, 33)):
        field = np.random.default_rng(4).random(shape, dtype=np.float32)
        margin, rows, columns = by_hand.margins(shape, DISPARITY)
        lf = LightField.from_array(field, device=device)
        picture = refocus(lf, disparity=DISPARITY).to_numpy()
        inner = picture[margin : margin + rows, margin : margin + columns]
        for one in by_hand.by_hand(field, DISPARITY, (1, 2)):
            # OpenCV rounds the fraction of a shift to 1/32 of a pixel
            limit = 0.04 if "OpenCV" in one.name else 2e-6
            np.testing.assert_allclose(np.asarray(one.run()), inner, atol=limit, err_msg=one.name)
