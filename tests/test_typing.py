"""A user's script outside the checkout sees the types of the public functions."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

SCRIPT = """\
import physconvex
from physconvex import diagnose, dynamics, fem, predict, reconstruct, refine, simulate
from physconvex.reduced import NamedParameters, ReducedBodies, ReducedScene

reveal_type(predict("clip.mp4"))
reveal_type(refine("capture"))
reveal_type(diagnose("capture"))
reveal_type(reconstruct("capture"))
reveal_type(simulate("ball.obj"))
reveal_type(physconvex.predict("clip.mp4").youngs_modulus_interval)
predict("clip.mp4", density="heavy")


def rolled_out(full: fem.Scene, reduced: ReducedScene, bodies: ReducedBodies) -> None:
    reveal_type(dynamics.simulate(full))
    reveal_type(dynamics.simulate(reduced))
    reveal_type(dynamics.simulate(bodies))
    reveal_type(dynamics.simulate_with_sensitivities(NamedParameters(reduced, ("poisson_ratio",))))
"""

REVEALED = [
    "inference.prediction.Prediction",
    "inference.refinement.result.Refinement",
    "physconvex.gap.page.report.GapReport",
    "inference.reconstruction.Reconstruction",
    "physconvex.play.roll_out.PlayedObject",
]


@pytest.mark.slow
def test_public_functions_reveal_their_types(tmp_path: Path) -> None:
    script = tmp_path / "users_script.py"
    script.write_text(SCRIPT)
    # the settings of the check, whose stored results are taken where the check was made
    result = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", "pyproject.toml", str(script)],
        capture_output=True, text=True, cwd=ROOT, check=False, env={"PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    notes = [line for line in result.stdout.splitlines() if "Revealed type" in line]
    for note, expected in zip(notes, REVEALED, strict=False):
        assert expected in note, result.stdout + result.stderr
    assert "tuple[float, float]" in notes[5].replace("builtins.", "")
    kinds = ("fem.scene.Trajectory", "reduced.trajectory.ReducedTrajectory", "reduced.trajectory.BodiesTrajectory")
    assert all(f'"physconvex.{kind}"' in note for kind, note in zip(kinds, notes[6:9], strict=True))
    assert "SensitiveTrajectory[physconvex.reduced.trajectory.ReducedTrajectory]" in notes[9]
    assert 'Argument "density" to "predict" has incompatible type "str"' in result.stdout
