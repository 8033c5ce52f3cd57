"""The result of a refinement: `Refinement`, its parts, its JSON form."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float
from pydantic import JsonValue

from inference.reconstruction import Reconstruction
from inference.refinement.appearance import Appearance
from inference.refinement.motion import RefinedMotion
from inference.refinement.rigid_drift import RigidDrift
from inference.units import format_pascals, format_pascals_range
from physconvex import InputError
from physconvex.identify import FullRun, Identifiability, Iteration
from physconvex.io import Picture, html_summary, load_capture

REFINEMENT_SCHEMA = "physconvex/refinement/1"
_MATERIAL = ("log10_youngs_modulus", "poisson_ratio")
_NINETY = 1.6448536269514722  # quantile of a normal distribution, both sides
UNITS = {
    "log10_youngs_modulus": "log10(Pa)",
    "poisson_ratio": "1",
    "density": "kg/m^3",
    "damping_time": "s",
    "air_drag": "1/s",
    "friction": "1",
    "floor_height": "m",
    "contact_damping": "s",
    "log10_contact_stiffness": "log10(Pa/m)",
    "gravity": "m/s^2",
    "wind": "m/s",
    "initial_velocity": "m/s",
    "initial_angular_velocity": "rad/s",
    "initial_position": "m",
    "initial_orientation": "rad",
}


def unit_of(name: str) -> str:
    """Unit of a parameter."""
    return UNITS[name] if name in UNITS else UNITS[name.rpartition("_")[0]]


@dataclass(frozen=True)
class FittedParameter:
    """One parameter.

    Attributes:
        name: of `physconvex.reduced.PARAMETERS`.
        value: [unit].
        noise_sigma: standard deviation from the noise of the data. It is enlarged by the root of the reduced χ² if the
            residual exceeds the stated noise, and at least that of residuals correlated within a frame.
        model_error: standard deviation by the remaining model error; NaN if no finer model is tried.
        interval: 90 %, of noise, model and geometry error together; None at a bound, and if the model does not fit the
            recording.
        lower, upper: bounds.
        prior: mean and standard deviation, or None.
        geometry_error: standard deviation by the error of a reconstructed body; NaN if unknown, 0 if it is given.
    """

    name: str
    value: float
    noise_sigma: float
    model_error: float
    interval: tuple[float, float] | None
    lower: float
    upper: float
    prior: tuple[float, float] | None = None
    geometry_error: float = 0.0

    @property
    def sigma(self) -> float:
        """Noise, model and geometry error together."""
        return float(np.linalg.norm(np.nan_to_num([self.noise_sigma, self.model_error, self.geometry_error])))

    @property
    def label(self) -> str:
        """Name and unit."""
        unit = unit_of(self.name)
        return self.name if unit == "1" else f"{self.name} [{unit}]"

    @property
    def interval_in_words(self) -> str:
        """Ends of the 90 % interval, or "none"."""
        return "none" if self.interval is None else f"{self.interval[0]:.5g} … {self.interval[1]:.5g}"

    def to_json(self) -> dict[str, JsonValue]:
        """Plain values; NaN and infinities become null."""
        return {
            "value": self.value,
            "unit": unit_of(self.name),
            "noise_sigma": _plain(self.noise_sigma),
            "model_error": _plain(self.model_error),
            "geometry_error": _plain(self.geometry_error),
            "interval_90": None if self.interval is None else [float(v) for v in self.interval],
            "bounds": [_plain(self.lower), _plain(self.upper)],
            "prior": None if self.prior is None else list(self.prior),
        }


@dataclass(frozen=True)
class StageEstimate:
    """E and ν as one stage of a refinement gives them.

    Attributes:
        name: network, convex twin or corrected.
        log10_youngs_modulus, poisson_ratio: values, E in Pa.
        intervals: 90 %, of log10 E and ν; None where there is none.
    """

    name: str
    log10_youngs_modulus: float
    poisson_ratio: float
    intervals: tuple[tuple[float, float] | None, tuple[float, float] | None]

    @classmethod
    def of(cls, name: str, estimates: Sequence[FittedParameter], fixed: Mapping[str, float]) -> StageEstimate:
        """From fitted parameters; those that are held have no interval."""
        known = {e.name: e for e in estimates}
        values = [known[n].value if n in known else fixed[n] for n in _MATERIAL]
        first, second = (known[n].interval if n in known else None for n in _MATERIAL)
        return cls(name, values[0], values[1], (first, second))

    def to_json(self) -> dict[str, JsonValue]:
        """Plain values."""
        values = (self.log10_youngs_modulus, self.poisson_ratio)
        entries = zip(_MATERIAL, values, self.intervals, strict=True)
        return {n: {"value": v, "interval_90": None if i is None else [*i]} for n, v, i in entries}


def interval_of(value: float, sigma: float, lower: float, upper: float) -> tuple[float, float]:
    """90 % of a normal distribution, cut at the bounds."""
    return max(value - _NINETY * sigma, lower), min(value + _NINETY * sigma, upper)


def deviation_of(interval: tuple[float, float]) -> float:
    """Standard deviation of a normal distribution with those 90 %."""
    return (interval[1] - interval[0]) / (2 * _NINETY)


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


@dataclass(frozen=True)
class ReconstructionRow:
    """The first stage of a refinement without a given geometry.

    Attributes:
        volume: of the body [m³].
        size: longest edge of its bounding box [m].
        views: number of pictures that it is from.
        unseen: share of its surface that fewer than two pictures show.
        psnr: mean over the pictures [dB], of the convex field that the body is from.
        seconds: time of the field's fit and of the body [s].
    """

    volume: float
    size: float
    views: int
    unseen: float
    psnr: float
    seconds: float

    def __str__(self) -> str:
        return (
            f"body from {self.views} pictures: {1e6 * self.volume:.4g} cm³, {1e3 * self.size:.4g} mm long, "
            f"{100 * self.unseen:.0f} % of the surface unseen, PSNR {self.psnr:.1f} dB, {self.seconds:.0f} s"
        )


def row_of(made: Reconstruction) -> ReconstructionRow:
    """The row of a reconstruction with a body."""
    record = made.to_json()
    body, psnr = record["body"], record["training"]["mean"]["psnr"]
    assert body is not None
    seconds = record["seconds"] + body["seconds"]
    return ReconstructionRow(body["volume"], body["size"], body["views"], body["unseen"], psnr, seconds)


@dataclass(frozen=True, eq=False)
class Refinement:
    """Parameters with uncertainty, motion and history of one capture.

    Attributes:
        path: the capture folder.
        estimates: the free parameters.
        fixed: values that are held fixed.
        covariance: of the noise, in the parameters' units, shape [K, K], in the order of `estimates`.
        reduced_chi_square: squares of the whitened residuals over degrees of freedom.
        residual_rms: root mean square of the residuals by source, in standard deviations of its stated noise.
        frame_errors: rms difference between the full and a finer model by frame, in standard deviations of the noise;
            residuals of a frame are divided by √(1 + its square).
        future_rms: rms distance of the markers in the frames after the fitted ones [m]; NaN without.
        identifiability: how well the data determine the parameters.
        history: of the last search.
        reduced_values: result of the reduced model alone, shape [K].
        full_runs: runs of the full model.
        converged: whether search and correction meet their tolerances.
        motion: of the fitted model.
        observed_frames: fitted frames.
        sources: fitted observations, such as "12 markers" or "camera front: 80 points".
        warnings: notes for the user.
        nuisances: camera pose and time offset, if they are free, by name and unit.
        appearance: the object as a convex field that moves with the body; None without one.
        drift: rigid drift of the recording from the model after a contact; None if none is likely.
        followed: the motion with that drift, as in the recording; after it the full model from its last state there
            (its handles are the model's).
        reconstruction: of the body; None if its geometry is given.
        stages: E and ν after each stage; the last entry is the result.
    """

    path: str
    estimates: tuple[FittedParameter, ...]
    fixed: dict[str, float]
    covariance: Float[np.ndarray, "K K"]
    reduced_chi_square: float
    residual_rms: dict[str, float]
    frame_errors: Float[np.ndarray, " T"]
    future_rms: float
    identifiability: Identifiability
    history: tuple[Iteration, ...]
    reduced_values: Float[np.ndarray, " K"]
    full_runs: tuple[FullRun, ...]
    converged: bool
    motion: RefinedMotion
    observed_frames: int
    sources: tuple[str, ...]
    warnings: tuple[str, ...]
    nuisances: dict[str, float]
    appearance: Appearance | None = None
    drift: RigidDrift | None = None
    followed: RefinedMotion | None = None
    reconstruction: ReconstructionRow | None = None
    stages: tuple[StageEstimate, ...] = ()

    def __getitem__(self, name: str) -> FittedParameter:
        """The estimate of a free parameter."""
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise KeyError(name)

    def _value(self, name: str) -> float:
        return self.fixed[name] if name in self.fixed else self[name].value

    @property
    def youngs_modulus(self) -> float:
        """E [Pa]."""
        return float(10.0 ** self._value("log10_youngs_modulus"))

    @property
    def youngs_modulus_interval(self) -> tuple[float, float] | None:
        """90 % interval of E [Pa]; None where E was held, or has none."""
        held = "log10_youngs_modulus" in self.fixed
        ends = None if held else self["log10_youngs_modulus"].interval
        return None if ends is None else (10.0 ** ends[0], 10.0 ** ends[1])

    @property
    def poisson_ratio(self) -> float:
        """ν."""
        return self._value("poisson_ratio")

    def _repr_html_(self) -> str:
        """Numbers with their 90 % intervals and the picture of `fit.png`, for a notebook."""
        from inference.refinement.pictures import draw_fit

        ends, modulus = self.youngs_modulus_interval, format_pascals(self.youngs_modulus)
        rows = [
            ("Young's modulus (90 %)", modulus if ends is None else f"{modulus} ({format_pascals_range(*ends)})"),
            ("Poisson's ratio", f"{self.poisson_ratio:.4f}"),
        ]
        rows += [(f"{e.label} (90 %)", f"{e.value:.5g} ({e.interval_in_words})") for e in self.estimates]
        rows += [] if self.reconstruction is None else [("reconstruction", str(self.reconstruction))]
        rows.append(("fitted", ", ".join(self.sources)))
        drawn, pictures = io.BytesIO(), []
        try:
            draw_fit(self, load_capture(self.path), drawn)
            pictures = [Picture(drawn.getvalue(), "what was seen and the model, the search, the estimates")]
        except InputError:  # the capture no longer exists
            pass
        notes = [*self.identifiability.sentences, *self.warnings]
        return html_summary(f"Refinement of {self.path}", rows, pictures=pictures, notes=notes)

    def to_json(self) -> dict[str, JsonValue]:
        """Everything but the arrays of the motion; docs/reference/refinement_files.md describes each entry."""
        names, told, ends = [e.name for e in self.estimates], self.identifiability, self.youngs_modulus_interval
        interval: JsonValue = None if ends is None else [*ends]

        def by_name(values: Float[np.ndarray, " K"]) -> dict[str, JsonValue]:
            return dict(zip(names, map(float, values), strict=True))

        return {
            "schema": REFINEMENT_SCHEMA,
            "path": self.path,
            "youngs_modulus": {"value": self.youngs_modulus, "unit": "Pa", "interval_90": interval},
            "stages": {stage.name: stage.to_json() for stage in self.stages},
            "parameters": {e.name: e.to_json() for e in self.estimates},
            "fixed": {name: {"value": value, "unit": unit_of(name)} for name, value in self.fixed.items()},
            "noise_covariance": {"order": [*names], "matrix": self.covariance.tolist()},
            "reduced_chi_square": self.reduced_chi_square,
            "residual_rms": {**self.residual_rms},
            "model_error_by_frame": [float(e) for e in self.frame_errors],
            "future_rms_m": _plain(self.future_rms),
            "identifiability": {
                "condition": _plain(told.condition),
                "undetermined": [{"shares": dict(d.shares), "sigma_in_steps": d.sigma} for d in told.null_directions],
                "at_bounds": list(told.at_bounds),
                "in_words": list(told.sentences),
            },
            "reduced_model_alone": by_name(self.reduced_values),
            "full_model_runs": [
                {"values": by_name(run.values), "misfit": _plain(run.misfit), "rms_to_start_m": _plain(run.distance)}
                for run in self.full_runs
            ],
            "history": [{"values": by_name(i.values), "misfit": i.misfit, "damping": i.damping} for i in self.history],
            "converged": self.converged,
            "motion_model": self.motion.model,
            "reduced_model_rms_m": dict(
                zip(("smooth_weights", "refined_weights"), self.motion.reduced_gap, strict=False)
            ),
            "convex_field": self.appearance.to_json() if self.appearance else None,
            "frames": len(self.motion.times),
            "observed_frames": self.observed_frames,
            "sources": list(self.sources),
            "warnings": list(self.warnings),
            "nuisances": {**self.nuisances},
            "rigid_drift": self.drift.to_json() if self.drift else None,
            "reconstruction": None if self.reconstruction is None else asdict(self.reconstruction),
        }
