"""All checks, in order."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from clplen.selftest import basics, cues, frames, lenses, matched, scenes, views, volumes, waves
from clplen.selftest.check import Check, CheckResult, run_check

if TYPE_CHECKING:
    from clplen.compute.device import Device

Watch = Callable[[CheckResult], None]

CHECKS: tuple[Check, ...] = (
    *basics.CHECKS,
    *waves.CHECKS,
    *lenses.CHECKS,
    *views.CHECKS,
    *cues.CHECKS,
    *matched.MATCHING_CHECKS,
    *frames.CHECKS,
    *scenes.SCENE_CHECKS,
    *volumes.VOLUME_CHECKS,
)


def run_checks(
    device: Device, *, names: Iterable[str] | None = None, watch: Watch | None = None
) -> list[CheckResult]:
    """Compare what a device computes with float64 NumPy, in this process.

    Parameters
    ----------
    device : Device
        In single precision.
    names : iterable of str, optional
        Of the checks to run; default all.
    watch : callable, optional
        Called with each result when it is there.

    Returns
    -------
    list of CheckResult
        One for each check, in the order of `CHECKS`; errors are results, not raised.

    Raises
    ------
    ValueError
        If there is no check of a name.
    """
    results = []
    for check in chosen(names):
        results.append(run_check(check, device))
        if watch is not None:
            watch(results[-1])
    return results


def chosen(names: Iterable[str] | None) -> list[Check]:
    """The checks of these names, in order; None: all.

    Raises
    ------
    ValueError
        If there is no check of a name.
    """
    if names is None:
        return list(CHECKS)
    wanted = set(names)
    unknown = sorted(wanted - {check.name for check in CHECKS})
    if unknown:
        raise ValueError(f"There is no check {unknown[0]!r}.")
    return [check for check in CHECKS if check.name in wanted]
