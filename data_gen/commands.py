"""Make FEM-simulated, rendered training data and captures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from tqdm import tqdm

from data_gen.config import load_config
from data_gen.engines import EngineName
from data_gen.generate import TaskReport, generate_dataset

__all__ = ["app"]

app = typer.Typer(help=__doc__, no_args_is_help=True)


@app.callback()
def _generate() -> None:
    """Make FEM-simulated, rendered training data and captures."""


@app.command("dataset")
def dataset(
    out: Annotated[Path, typer.Option(help="Folder of the data set; made, or finished if it was begun before.")],
    count: Annotated[int, typer.Option(min=1, help="Number of simulations; each gives `camera.views` clips.")] = 100,
    config: Annotated[str, typer.Option(help="Preset name or YAML file.")] = "training",
    seed: Annotated[int, typer.Option(help="Seed of everything random.")] = 0,
    workers: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
    engine: Annotated[EngineName, typer.Option(help="Where the workers run.")] = "local",
    objects: Annotated[Path | None, typer.Option(help="Folder of meshes to use instead of procedural bodies.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Override, as material.poisson_ratio=[0.3,0.4]; repeatable.")
    ] = None,
    progress: Annotated[bool, typer.Option(help="Show a progress bar.")] = True,
) -> None:
    """Simulate and render clips of dropped bodies, with labels and interior samples."""
    overrides = list(settings or [])
    if objects is not None:
        overrides.append(f"objects.folder={objects}")
    resolved = load_config(config, overrides=overrides)
    with tqdm(total=count, unit="simulation", disable=not progress) as bar:

        def advance(report: TaskReport) -> None:
            bar.set_postfix(simulate=f"{report.simulate_seconds:.1f} s", render=f"{report.render_seconds:.1f} s")
            bar.update()

        summary = generate_dataset(
            out, count=count, config=resolved, seed=seed, workers=workers, engine=engine, on_report=advance
        )
    share = summary.failed_attempts / max(summary.made + summary.failed_attempts, 1)
    typer.echo(
        f"{out}: {summary.made} simulations made, {summary.already_there} were there, "
        f"{summary.failed_attempts} failed attempts replaced ({share:.1%})"
    )
