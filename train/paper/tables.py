"""Means over objects and Markdown tables of an evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["markdown", "summary"]

_WAYS = {"constant": "constant guess", "network": "network alone", "published_way": "published way, run here",
         "refined": "refined"}  # fmt: skip


_FOLLOWED, _POINTS, _ITSELF = "followed", "points_K", "truth_itself"
# Not seen in the paper itself, whose tables were not at hand.
PUBLISHED = (
    "Published for PhysConvex (arXiv 2602.18886), on its authors' own data and views, so not comparable row by row: "
    "mean error of log E 0.37; as wizwand.com lists its results on scanned objects: PSNR 30 dB observed, 25.71 dB "
    "future, error of log E 0.32 on one object (backpack). The base of the logarithm is not told there."
)


def _label(part: str) -> str:
    if part == _FOLLOWED:
        return "refined, with its rigid drift"
    if part == _ITSELF:
        return "truth of half the nodes"
    return _WAYS.get(part, part.replace("reduced_M", "reduced model alone, M = "))


def _ways(rows: Sequence[dict[str, Any]]) -> list[str]:
    return [part for part in dict.fromkeys(p for row in rows for p in row) if part in _WAYS or "reduced_M" in part]


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Means over the objects: |Δlog10 E|, |Δν|, coverage, pictures, changes, time, primitives; failures by name."""
    out: dict[str, Any] = {"objects": len(rows), "identification": {}, "pictures": {}, "changes": {}, "failures": []}
    for way in _ways(rows):
        good = [row[way] for row in rows if "errors" in row.get(way, {})]
        out["failures"] += [
            f"{row['object']}: {way}: {row[way]['failure']}" for row in rows if "failure" in row.get(way, {})
        ]
        if not good:
            continue
        errors = np.abs([row["errors"] for row in good])
        out["identification"][way] = {
            "log10_error": float(errors[:, 0].mean()),
            "poisson_error": float(errors[:, 1].mean()),
            "process_seconds": float(np.mean([row["process_seconds"] for row in good])),
            "objects": len(good),
        }
        _add_pictures(out["pictures"], way, good)
    _add_pictures(out["pictures"], _FOLLOWED, [row[_FOLLOWED] for row in rows if _FOLLOWED in row])
    _add_pictures(out["pictures"], _ITSELF, [row[_ITSELF] for row in rows if _ITSELF in row])
    fields = [row["field"] for row in rows if "convexes" in row.get("field", {})]
    kinds = ("convexes", "psnr", "process_seconds")
    out["field"] = {kind: float(np.mean([one[kind] for one in fields])) for kind in kinds} if fields else None
    out["points"] = _points_of(rows)
    refined = [row["refined"] for row in rows if "errors" in row.get("refined", {})]
    covered = [c for row in refined for c in row["covered"] if c is not None]
    out["coverage_90"], out["intervals"] = (float(np.mean(covered)) if covered else None), len(covered)
    for change in refined[0]["changes"] if refined else ():
        values = [(row["changes"][change]["rms_m"], row["changes"][change]["change_rms_m"]) for row in refined]
        out["changes"][change] = dict(zip(("rms_m", "change_rms_m"), np.mean(values, axis=0).tolist(), strict=True))
    return out


def _points_of(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Means of the ablation over K: PSNR of the first images, and of the front view in each motion [dB]."""
    out = {}
    for part in dict.fromkeys(p for row in rows for p in row if p.startswith(_POINTS)):
        good = [row[part] for row in rows if "observed" in row.get(part, {})]
        if good:
            names = dict.fromkeys(name for one in good for name in one["observed"])
            front = {n: float(np.mean([g["observed"][n]["front"]["psnr"] for g in good])) for n in names}
            still = float(np.mean([g["first_images"]["psnr"] for g in good]))
            convexes = float(np.mean([g["convexes"] for g in good]))
            out[part.removeprefix(_POINTS)] = {"convexes": convexes, "first_images_psnr": still, "front_psnr": front}
    return out


def _points_table(points: dict[str, Any]) -> list[str]:
    if not points:
        return []
    motions = list(dict.fromkeys(n for p in points.values() for n in p["front_psnr"]))
    heads = ["refined" if name == "refined" else f"M = {name[1:]}, reduced" for name in motions]
    lines = [
        "",
        "## Points per convex K",
        "",
        "PSNR [dB] of the first images, and of the observed frames' front view in",
    ]
    lines += ["the motion of each model.", "", "| K | convexes | first images | " + " | ".join(heads) + " |"]
    lines += ["|---|---|---|" + "---|" * len(motions)]
    for count, p in points.items():
        cells = [f"{p['front_psnr'][name]:.2f}" if name in p["front_psnr"] else "–" for name in motions]
        lines.append(f"| {count} | {p['convexes']:.0f} | {p['first_images_psnr']:.2f} | " + " | ".join(cells) + " |")
    return lines


def _add_pictures(target: dict[str, Any], way: str, good: Sequence[dict[str, Any]]) -> None:
    for part in ("observed", "future"):
        for view in ("front", "others"):
            found = [row["pictures"][part][view] for row in good if view in row.get("pictures", {}).get(part, {})]
            if found:
                known = [n for n in ("psnr", "ssim", "psnr_object") if all(n in f for f in found)]
                means = {n: float(np.mean([f[n] for f in found])) for n in known}
                quality = [f["fovvdp"] for f in found if f.get("fovvdp") is not None]
                means |= {"fovvdp": float(np.mean(quality))} if quality else {}
                target.setdefault(way, {}).setdefault(part, {})[view] = means


def markdown(rows: Sequence[dict[str, Any]], note: str) -> str:
    """The tables, as a page."""
    told = summary(rows)
    lines = ["# Tables", "", note, "", "Errors are fit less truth; E in decades (log10).", "", "## Identification", ""]
    ways = _ways(rows)
    lines += ["| object | log10 E, ν | " + " | ".join(_label(way) for way in ways) + " |"]
    lines += ["|---|---|" + "---|" * len(ways)]
    for row in rows:
        truth = list(row["truth"].values())
        cells = [_pair(row.get(way)) for way in ways]
        lines.append(f"| {row['object']} | {truth[0]:.2f}, {truth[1]:.2f} | " + " | ".join(cells) + " |")
    means = [told["identification"].get(way) for way in ways]
    cells = ["–" if m is None else f"{m['log10_error']:.3f} / {m['poisson_error']:.3f}" for m in means]
    lines.append("| **mean of absolutes** | | " + " | ".join(cells) + " |")
    seconds = ["–" if m is None else f"{m['process_seconds']:.0f} s" for m in means]
    lines.append("| processor time | | " + " | ".join(seconds) + " |")
    share = told["coverage_90"]
    lines += [
        "",
        f"90 % intervals that hold the truth: {'–' if share is None else f'{share:.2f}'} of {told['intervals']}.",
        "",
        PUBLISHED,
    ]
    lines += ["", "## Pictures", "", "| | frames | views | PSNR | SSIM | PSNR on the object | FovVideoVDP |"]
    lines += ["|---|---|---|---|---|---|---|"]
    for way, parts in told["pictures"].items():
        for part, views in parts.items():
            for view, s in views.items():
                forms = {"psnr": ".2f", "ssim": ".4f", "psnr_object": ".2f", "fovvdp": ".2f"}
                numbers = " | ".join(format(s[n], form) if n in s else "–" for n, form in forms.items())
                lines.append(f"| {_label(way)} | {part} | {view} | {numbers} |")
    if (field := told["field"]) is not None:
        lines += [
            "",
            f"Drawn with fields of {field['convexes']:.0f} convexes in the mean, fitted to the first images of all "
            f"cameras ({field['psnr']:.1f} dB) in {field['process_seconds']:.0f} s of a processor.",
        ]
    lines += ["", "## Generalisation", "", "| change | distance from the truth [mm] | how far the change goes [mm] |"]
    lines += ["|---|---|---|"]
    lines += [
        f"| {name} | {1e3 * c['rms_m']:.1f} | {1e3 * c['change_rms_m']:.1f} |" for name, c in told["changes"].items()
    ]
    lines += _points_table(told["points"])
    if told["failures"]:
        lines += ["", "## Failures", "", *(f"- {text}" for text in told["failures"])]
    return "\n".join(lines) + "\n"


def _pair(part: dict[str, Any] | None) -> str:
    """Errors of a way for one object; a dash where it was not run."""
    if part is None:
        return "–"
    return "failed" if "failure" in part else f"{part['errors'][0]:+.3f} / {part['errors'][1]:+.3f}"
