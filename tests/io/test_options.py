"""One options model: command line, JSON and errors."""

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import pytest
import typer
from pydantic import Field
from typer.testing import CliRunner

from physconvex import InputError
from physconvex.io import CommandLine, Options, command


def _assignment(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    return name, float(value)


class Inner(Options):
    time_offset: float = 0.0
    """Free the clock [s]."""


class FitOptions(Options):
    weights: Annotated[int, Field(ge=1)] = 20
    """Number of skinning weights."""
    start: Literal["auto", "scan"] = "auto"
    """Where the search begins."""
    cameras: Annotated[tuple[str, ...] | None, CommandLine("--camera")] = None
    """Use this camera alone."""
    fixed: Annotated[Mapping[str, float], CommandLine("--fix", parse=_assignment)] = Field(default_factory=dict)
    """Hold a parameter."""
    drift: bool = True
    """Let the recording drift."""
    clock: Inner = Field(default_factory=Inner)
    budget: Annotated[int, CommandLine(hidden=True)] = 6
    """From Python alone."""


@pytest.fixture
def run():
    seen = []

    @command
    def fit(
        capture: Annotated[Path, typer.Argument(help="A folder.")], options: FitOptions, out: Path = Path("o")
    ) -> None:
        """Fit."""
        seen.append((capture, options, out))

    app = typer.Typer()
    app.command()(fit)

    def call(*arguments: str):
        result = CliRunner().invoke(app, arguments)
        if isinstance(result.exception, InputError):
            raise result.exception
        assert result.exit_code == 0, result.output
        return seen[-1] if seen else result.output

    return call


def test_every_field_is_an_option(run) -> None:
    assert run("c") == (Path("c"), FitOptions(), Path("o"))
    given = ["--weights", "3", "--start", "scan", "--camera", "a", "--camera", "b", "--no-drift"]
    _, options, out = run("c", *given, "--fix", "friction=0.5", "--time-offset", "0.01", "--out", "there")
    assert options == FitOptions(
        weights=3,
        start="scan",
        cameras=("a", "b"),
        drift=False,
        fixed={"friction": 0.5},
        clock=Inner(time_offset=0.01),
    )
    assert out == Path("there")


def test_help_comes_from_the_field(run) -> None:
    text = run("--help")
    assert "Number of skinning" in text and "--budget" not in text and "[default: 20]" in text


def test_help_of_the_model_has_plain_types_and_the_help_of_each_field() -> None:
    signature = inspect.signature(FitOptions)
    assert signature.parameters["weights"].annotation is int and signature.parameters["weights"].default == 20
    assert "Annotated" not in str(signature) and "CommandLine" not in str(signature)
    assert "\n    weights: Number of skinning" in (inspect.getdoc(FitOptions) or "")


def test_values_out_of_range_are_told_by_name(run) -> None:
    with pytest.raises(InputError, match="weights: got 0; expected at least 1"):
        run("c", "--weights", "0")
    with pytest.raises(InputError, match="start: got 'x'; expected one of auto, scan"):
        FitOptions(start="x")
    with pytest.raises(InputError, match="wieghts: no such option"):
        FitOptions(wieghts=3)
    with pytest.raises(InputError, match="weights: got 0"):
        FitOptions().replace(weights=0)
    assert FitOptions.or_default(None) == FitOptions() and FitOptions.or_default(FitOptions(weights=2)).weights == 2


@pytest.mark.wrong_types
def test_options_of_another_type_are_refused() -> None:
    with pytest.raises(InputError, match="options: got a value of type dict; expected FitOptions"):
        FitOptions.or_default({"weights": 2})


def test_json_holds_every_field() -> None:
    stored = FitOptions(cameras=("a",)).to_json()
    assert FitOptions(**stored) == FitOptions(cameras=("a",))


class Listed(Options):
    """Values in one option."""

    numbers: Annotated[tuple[float, ...], CommandLine(commas=True)] = (1.0,)
    """Some numbers."""


def test_values_stand_in_one_option_separated_by_commas():
    seen = []

    @command
    def run(options: Listed) -> None:
        seen.append(options.numbers)

    app = typer.Typer()
    app.command()(run)
    for arguments in ([], ["--numbers", "2, 3.5,"]):
        assert CliRunner().invoke(app, arguments).exit_code == 0
    assert seen == [(1.0,), (2.0, 3.5)]
    assert CliRunner().invoke(app, ["--numbers", "two"]).exit_code != 0
