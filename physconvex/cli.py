"""The console script `physconvex`: one command per entry point of the group `physconvex.commands`.

An entry point names either a function, which becomes a command (options as `Annotated[..., typer.Option()]`),
or a `typer.Typer` with sub-commands. It is imported only when its command runs, so `physconvex --help` stays
light: the one-line help is read from the source of the named object, or of its module, without importing it.

Exit codes: 0 all done, 1 some inputs failed (the command raises `typer.Exit(1)`), 2 wrong usage or bad input.
"""

import ast
import os
import sys
import traceback
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

import physconvex
from physconvex.errors import InputError, PhysconvexError

COMMAND_GROUP = "physconvex.commands"


class CommandLoadError(PhysconvexError, ImportError):
    """The object behind a command's entry point could not be imported."""


def _commands() -> dict[str, EntryPoint]:
    """Entry points of the installed packages by command name, in alphabetical order."""
    return {point.name: point for point in sorted(entry_points(group=COMMAND_GROUP), key=lambda p: p.name)}


def _source_file(module: str) -> Path | None:
    """The file of a module, found without importing its package; `None` if it is not a plain Python file."""
    package, *inner = module.split(".")
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        return None
    if not inner:
        return Path(spec.origin)
    stem = Path(spec.origin).parent.joinpath(*inner)
    return next((path for path in (stem.with_suffix(".py"), stem / "__init__.py") if path.is_file()), None)


def _short_help(point: EntryPoint) -> str:
    """First line of the docstring of the named function, else of its module; empty if there is none."""
    path = _source_file(point.module)
    if path is None:
        return ""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == point.attr]
    docstrings = [*map(ast.get_docstring, functions), ast.get_docstring(tree)]
    return next((text.splitlines()[0] for text in docstrings if text), "")


def _load(point: EntryPoint) -> TyperCommand | TyperGroup:
    """Import the object behind an entry point and turn it into a command or a group of commands."""
    try:
        target = point.load()
    except Exception as error:
        raise CommandLoadError(
            f"command {point.name!r}: its entry point {point.value!r} could not be imported "
            f"({type(error).__name__}: {error}); `physconvex --traceback {point.name}` shows where"
        ) from error
    if isinstance(target, typer.Typer):
        command = _typer_command(target)
    else:
        single = typer.Typer(add_completion=False)
        single.command(name=point.name)(target)
        command = _typer_command(single)
    command.name = point.name
    _escape_brackets(command)
    return command


def _typer_command(app: typer.Typer) -> TyperCommand | TyperGroup:
    command = typer.main.get_command(app)
    assert isinstance(command, TyperCommand | TyperGroup)
    return command


def _escape_brackets(command: TyperCommand | TyperGroup) -> None:
    """Units such as [m] are text, which rich would take for markup and leave out of the help."""
    for option in command.params:
        if isinstance(option, TyperArgument | TyperOption) and option.help:
            option.help = escape(option.help)
    for inner in getattr(command, "commands", {}).values():
        _escape_brackets(inner)


class _EntryPointGroup(TyperGroup):
    """Lists commands by name and short help; imports one only when it is to run."""

    def list_commands(self, ctx: object) -> list[str]:
        return list(_commands())

    def get_command(self, ctx: object, cmd_name: str) -> TyperCommand | None:
        point = _commands().get(cmd_name)
        if point is None:
            return None
        return TyperCommand(cmd_name, help=_short_help(point), callback=None)

    def resolve_command(
        self, ctx: Any, args: list[str]
    ) -> tuple[str | None, TyperCommand | TyperGroup | None, list[str]]:
        name, placeholder, rest = super().resolve_command(ctx, args)
        if name is None or placeholder is None:
            return name, None, rest
        return name, _load(_commands()[name]), rest


app = typer.Typer(cls=_EntryPointGroup, no_args_is_help=True, pretty_exceptions_enable=False)


def _print_version(wanted: bool) -> bool:
    if wanted:
        typer.echo(f"physconvex {physconvex.__version__}")
        raise typer.Exit()
    return wanted


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
    traceback: Annotated[bool, typer.Option("--traceback", help="Show the full traceback of an error.")] = False,
) -> None:
    """Estimate material parameters and skinning weights of soft objects from video."""


def main(arguments: list[str] | None = None) -> None:
    """Run the program with `arguments` (default: those of the process) and exit with its code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    # numpy's BLAS works on small matrices here; its threads and torch's hinder each other. Read when numpy is loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        typer.main.get_command(app).main(arguments, prog_name="physconvex")
    except PhysconvexError as error:
        if arguments[:1] == ["--traceback"]:
            traceback.print_exc()
        print(f"physconvex: {error}", file=sys.stderr)
        sys.exit(2 if isinstance(error, InputError) else 1)
