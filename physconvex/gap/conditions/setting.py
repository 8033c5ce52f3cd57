"""Conditions of the recording: compliant or rigid floor, own linear elements or any, strong damping.

For a free body, short fits of the full-order model on either floor and either mesh, together with effects
(`physconvex.gap.conditions.joint_fits`), test floor and mesh at once. A mesh whose diagonals all run one way makes a
cube tumble after contact, which hides the floor, and the floor can hide the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.gap.base.baseline import FLOOR_LAW, Baseline, Report
from physconvex.gap.base.rough_fit import run_again
from physconvex.gap.conditions.capture_elements import mesh_of_capture_elements
from physconvex.gap.conditions.joint_fits import JointFits, damped_fit, on_giving_floor, sinks_in, softness
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import SETTING
from physconvex.identify import Fit


@dataclass(frozen=True, eq=False)
class Setting:
    """The rough base fit on the selected floor, and whether the recording's own elements are selected.

    Attributes:
        base: the rough base fit; its parameters include `FLOOR_LAW` for a compliant floor.
        own: None if not tested: for held bodies, and without affordable linear tetrahedra.
        damped: the base model with damping, E fitted along; None if that explains little.
    """

    base: Baseline
    own: bool | None
    damped: Baseline | None = None


def find_setting(base: Baseline, options: GapOptions, report: Report) -> Setting:
    """Test whether the floor is compliant, whether the capture's tetrahedra are the recording's, or the body is damped.

    `base` is the rough base fit, on a rigid floor. It is returned unchanged if none of that holds, or if such a model
    cannot be simulated.
    """
    if base.situation.clamped or not base.situation.touches:
        return Setting(base, None)
    try:
        return _asked(base, options, report)
    except ConvergenceError:
        return Setting(base, None)


def _asked(base: Baseline, options: GapOptions, report: Report) -> Setting:
    own, sinks = mesh_of_capture_elements(base), sinks_in(base)
    if own is None and not sinks:
        return _damped(base, options, report)
    joint, names = JointFits(base, options), (base.model.base, (*base.model.base, *FLOOR_LAW))
    report("fits in the company of effects")
    hard = joint.best(names[0], [np.append(base.fit.values, joint.nothing)])
    doses = joint.nothing if hard is None else hard.values[len(names[0]) :]
    soft = on_giving_floor(joint, doses) if sinks else None
    if soft is not None and softness(base, names[1], soft.values) > SETTING.soft_stiffness:
        soft = None
    if own is None and soft is None:
        return _damped(base, options, report)
    report("floor and elements of the recording")
    floors: list[tuple[tuple[str, ...], Fit]] = [(n, f) for n, f in zip(names, (hard, soft), strict=True) if f]
    tried: dict[tuple[bool, bool], Fit] = {}  # by own elements, compliant floor
    for mesh in (None,) if own is None else (None, own):
        for which, start in floors:
            found = joint.full(which, start, mesh)
            if found is not None:
                tried[mesh is not None, which is names[1]] = found
    if not tried:
        return Setting(base, None)
    misfits = {case: found.misfit for case, found in tried.items()}
    theirs, gives = _likeliest(misfits, refuted=base.situation.in_soft_floor)
    if gives:
        return Setting(_moved(base, joint, names[1], tried[theirs, gives]), None if own is None else theirs)
    return replace(_damped(base, options, report), own=None if own is None else theirs)


def _likeliest(misfits: dict[tuple[bool, bool], float], *, refuted: bool) -> tuple[bool, bool]:
    """Choose the elements (own ones or not) and the floor (compliant or not) from misfits by these two flags.

    `refuted` excludes a rigid floor, even if it fits well with wrong values.
    """
    possible = [case for case in misfits if case[1] or not refuted] or misfits
    return min(possible, key=lambda case: misfits[case] / SETTING.better ** sum(case))


def _damped(base: Baseline, options: GapOptions, report: Report) -> Setting:
    """The setting on a rigid floor, where only damping dissipates the energy of an impact."""
    report("scan over E and damping")
    damped = damped_fit(base, options)
    if damped is None:
        return Setting(base, None)
    joint, found = damped
    base = _moved(base, joint, base.model.base, found)
    model = replace(base.model, effects=joint.effects)
    return Setting(base, None, replace(base, model=model, fit=found, motion=model.motion(found.values)))


def _moved(base: Baseline, joint: JointFits, names: tuple[str, ...], found: Fit) -> Baseline:
    """The rough base fit at the values of a joint fit, without the added effects."""
    count = len(names)
    alone = replace(
        found, parameters=found.parameters[:count], values=found.values[:count], jacobian=found.jacobian[:, :count]
    )
    return run_again(base, alone, twin=joint.model(names, alone.values).twin)
