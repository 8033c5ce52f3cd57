"""Generate training data and captures by FEM simulation and rendering."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from tqdm import tqdm

from data_gen.benchmark_scenes import BenchmarkOptions
from data_gen.captures import RingOptions, generate_captures
from data_gen.config import GeneratorConfig, load_config
from data_gen.engines import WorkerOptions
from data_gen.generate import GenerationSummary, TaskReport, generate_dataset
from physconvex.io import command

app = typer.Typer(help=__doc__, no_args_is_help=True, add_completion=False)


@app.callback()
def _generate() -> None:
    """Generate training data and captures by FEM simulation and rendering."""


Out = Annotated[Path, typer.Option(help="Folder of the results; an unfinished one is completed.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Objects = Annotated[Path | None, typer.Option(help="Folder of meshes that replace the procedural bodies.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", help="Change a setting, such as material.poisson_ratio=[0.3,0.4]; repeatable."),
]
Config = Annotated[str, typer.Option(help="Preset (training, clean, captures) or YAML file.")]
Progress = Annotated[bool, typer.Option(help="Show a progress bar.")]


@app.command("dataset")
@command
def dataset(
    *,
    out: Out,
    count: Annotated[int, typer.Option(min=1, help="Number of simulations; each gives `camera.views` clips.")] = 100,
    config: Config = "training",
    seed: Seed = 0,
    work: WorkerOptions,
    objects: Objects = None,
    settings: Settings = None,
    progress: Progress = True,
) -> None:
    """Simulate and render clips of falling bodies, with labels and samples of their interior."""
    resolved = _resolved(config, settings, objects)
    with _advancing(count, "simulation", progress) as advance:
        summary = generate_dataset(out, count=count, config=resolved, seed=seed, work=work, on_report=advance)
    _report(out, "simulations", summary)


@app.command("captures")
@command
def captures_command(
    *,
    out: Out,
    count: Annotated[int, typer.Option(min=1, help="Number of captures; each has `camera.views` cameras.")] = 10,
    config: Config = "captures",
    seed: Seed = 0,
    options: RingOptions,
    work: WorkerOptions,
    objects: Objects = None,
    settings: Settings = None,
    progress: Progress = True,
) -> None:
    """Simulate falling bodies and film each with a ring of cameras. Writes videos, masks, meshes, tracks and the
    truth."""
    resolved = _resolved(config, settings, objects)
    with _advancing(count, "capture", progress) as advance:
        summary = generate_captures(
            out, count=count, config=resolved, seed=seed, options=options, work=work, on_report=advance
        )
    _report(out, "captures", summary)


@app.command("falls")
@command
def falls(
    *,
    out: Out,
    shapes: Annotated[int, typer.Option(min=1, help="Number of shapes.")] = 1720,
    each: Annotated[int, typer.Option(min=1, help="Number of falls of each shape.")] = 4,
    nodes: Annotated[int, typer.Option(help="Most nodes of a mesh.")] = 1900,
    config: Config = "training",
    seed: Seed = 0,
    work: WorkerOptions,
    settings: Settings = None,
    progress: Progress = True,
) -> None:
    """Draw and mesh falling bodies for `physconvex pretrain`, which simulates them on a GPU."""
    from data_gen.explicit.generate import generate_falls

    resolved = _resolved(config, [*(settings or []), f"objects.simulations_per_object={each}"], None)
    with tqdm(total=shapes, unit="shape", disable=not progress) as bar:
        count = generate_falls(
            out, shapes=shapes, config=resolved, seed=seed, nodes=nodes, work=work,
            on_file=lambda done: bar.update(done - bar.n),
        )  # fmt: skip
    typer.echo(f"{out}: {count} falls")


@app.command("benchmark")
@command
def benchmark_command(
    *,
    objects: Annotated[Path, typer.Option(help="Folder whose subfolders hold one textured mesh each.")],
    out: Out,
    only: Annotated[
        list[str] | None, typer.Option(help="Generate only this one of the chosen objects; repeatable. Default: all.")
    ] = None,
    options: BenchmarkOptions,
    progress: Progress = True,
) -> None:
    """Simulate and film falling or tossed textured objects for `physconvex evaluate paper`. The truth is stored
    separately."""
    from data_gen.benchmark import generate_benchmark

    total = len(only or options.names or ()) or options.count
    with tqdm(total=total, unit="object", disable=not progress) as bar:
        made = generate_benchmark(objects, out, options, only=only, on_object=lambda _: bar.update())
    typer.echo(f"{out}: {len(made)} objects: {', '.join(made)}")


def _resolved(config: str, settings: list[str] | None, objects: Path | None) -> GeneratorConfig:
    overrides = list(settings or [])
    if objects is not None:
        overrides.append(f"objects.folder={objects}")
    return load_config(config, overrides=overrides)


@contextmanager
def _advancing(count: int, unit: str, progress: bool) -> Iterator[Callable[[TaskReport, int], None]]:
    """A progress bar that advances with each report, from the state of an earlier run."""
    with tqdm(total=count, unit=unit, disable=not progress) as bar:

        def advance(report: TaskReport, done: int) -> None:
            if bar.n == 0:
                bar.initial = bar.n = done - 1
            bar.set_postfix(simulate=f"{report.simulate_seconds:.1f} s", render=f"{report.render_seconds:.1f} s")
            bar.update(done - bar.n)

        yield advance


def _report(out: Path, what: str, summary: GenerationSummary) -> None:
    share = summary.failed_attempts / max(summary.made + summary.failed_attempts, 1)
    typer.echo(
        f"{out}: {summary.made} {what} made, {summary.already_there} were there, "
        f"{summary.failed_attempts} failed attempts ({share:.1%})"
    )
    if summary.given_up:
        numbers = ", ".join(map(str, summary.given_up))
        typer.echo(f"given up, since every attempt failed: {what} {numbers}", err=True)
        raise typer.Exit(1)
