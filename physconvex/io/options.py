"""Options written once: a typed model makes a command's command line, with it its table in the docs, and its JSON.

class FitOptions(Options):
    weights: Annotated[int, Field(ge=1), CommandLine(panel="Models")] = 20
    \"""Number of skinning weights.\"""

@command
def fit(capture: Annotated[Path, typer.Argument()], options: FitOptions, out: Path = Path("fit")) -> None: ...
"""

from __future__ import annotations

import functools
import inspect
import types
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Self, TypeGuard, Union, get_args, get_origin, get_type_hints

import typer
from pydantic import JsonValue, ValidationError
from pydantic.fields import FieldInfo

from physconvex.errors import InputError
from physconvex.io.configuration import FrozenConfig, error_in_words


@dataclass(frozen=True)
class CommandLine:
    """Appearance of a field on the command line, as metadata of its annotation.

    Attributes:
        flag: name of the option; `--` and the field's name unless given.
        panel: its heading in `--help`.
        parse: of a field that is a mapping: from NAME=VALUE, which may be given several times, to name and value.
        commas: the values of a tuple stand in one option, separated by commas.
        hidden: the field is set from Python alone.
        bounded: `--help` shows the field's smallest value, and the command line is refused below it.
    """

    flag: str | None = None
    panel: str | None = None
    parse: Callable[[str], tuple[str, Any]] | None = None
    commas: bool = False
    hidden: bool = False
    bounded: bool = False


class Options(FrozenConfig):
    """Settings of a command. Docstrings of fields are their help; a field that is itself `Options` adds its own fields.

    Raises:
        InputError: an unknown name or a value out of range.
    """

    if not TYPE_CHECKING:

        def __init__(self, **values: Any) -> None:
            try:
                super().__init__(**values)
            except ValidationError as error:
                raise InputError(error_in_words(error)) from None

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """What `help` shows: types without what validation and the command line read, and the help of each field."""
        lines, parameters = [inspect.cleandoc(cls.__doc__ or ""), "", "Attributes:"], []
        for name, info in cls.model_fields.items():
            lines.append(f"    {name}: {' '.join((info.description or '').split())}")
            default = inspect.Parameter.empty if info.is_required() else info.get_default(call_default_factory=True)
            kind = inspect.Parameter.KEYWORD_ONLY
            parameters.append(inspect.Parameter(name, kind, default=default, annotation=info.annotation))
        cls.__doc__, cls.__signature__ = "\n".join(lines), inspect.Signature(parameters)

    @classmethod
    def or_default(cls, options: Self | None) -> Self:
        """The given options, or the defaults where there are none.

        Raises:
            InputError: something else is given, such as a dict.
        """
        if options is not None and not isinstance(options, cls):
            kind, name = type(options).__name__, cls.__name__
            raise InputError(f"options: got a value of type {kind}; expected {name}, made as {name}(name=value)")
        return cls() if options is None else options

    def replace(self, **changes: object) -> Self:
        """The same options with some fields changed, validated again."""
        return type(self)(**(dict(self) | changes))

    def to_json(self) -> dict[str, JsonValue]:
        """All settings, for a result's file."""
        return self.model_dump(mode="json")


def command(function: Callable[..., None]) -> Callable[..., None]:
    """A function for typer: each parameter annotated with `Options` becomes one option per field."""
    hints = get_type_hints(function, include_extras=True)
    parameters, models = [], {}
    for parameter in inspect.signature(function).parameters.values():
        hint = hints[parameter.name]
        if _is_options(hint):
            models[parameter.name] = hint
            parameters += [_parameter(name, info) for name, info in _fields(hint)]
        else:
            parameters.append(parameter.replace(annotation=hint, kind=inspect.Parameter.KEYWORD_ONLY))

    @functools.wraps(function)
    def run(**given: Any) -> None:
        made = {name: _built(model, given) for name, model in models.items()}
        function(**given, **made)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in parameters} | {"return": None}
    del run.__wrapped__
    return run


def _is_options(kind: object) -> TypeGuard[type[Options]]:
    return isinstance(kind, type) and issubclass(kind, Options)


def _fields(model: type[Options]) -> Iterator[tuple[str, FieldInfo]]:
    """The options of a command line, those of inner models included."""
    for name, info in model.model_fields.items():
        if _is_options(info.annotation):
            yield from _fields(info.annotation)
        elif not _command_line(info).hidden:
            yield name, info


def _built(model: type[Options], given: dict[str, Any]) -> Options:
    """The model of values from the command line, which are removed."""
    values: dict[str, object] = {}
    for name, info in model.model_fields.items():
        if _is_options(info.annotation):
            values[name] = _built(info.annotation, given)
        elif name in given:
            values[name] = _value(info, given.pop(name))
    return model(**values)


def _value(info: FieldInfo, given: Any) -> object:
    parse = _command_line(info).parse
    if parse is not None:
        return dict(map(parse, given or ()))
    if given is None:
        return info.get_default(call_default_factory=True)
    if _command_line(info).commas:
        return tuple(part.strip() for part in given.split(",") if part.strip())
    return tuple(given) if isinstance(given, list) else given


def _parameter(name: str, info: FieldInfo) -> inspect.Parameter:
    look, default = _command_line(info), info.get_default(call_default_factory=True)
    kind, repeated = (str | None, True) if look.commas else _kind(info.annotation)
    least = next((entry.ge for entry in info.metadata if look.bounded and hasattr(entry, "ge")), None)
    flags = [look.flag] if look.flag else []
    option = typer.Option(*flags, help=info.description, rich_help_panel=look.panel, min=least)
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=None if repeated else default, annotation=Annotated[kind, option]
    )


def _kind(annotation: object) -> tuple[Any, bool]:
    """The type of a field for typer, and whether the option may be given several times."""
    inner = _bare(annotation)
    if get_origin(inner) in (Union, types.UnionType):
        given = [_bare(part) for part in get_args(inner) if part is not type(None)]
        kind, repeated = _kind(given[0])
        return kind if repeated else kind | None, repeated
    if get_origin(inner) is tuple and get_args(inner)[-1] is Ellipsis:
        return list[_bare(get_args(inner)[0])] | None, True  # type: ignore[misc]
    origin = get_origin(inner)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return list[str] | None, True
    return inner, False


def _bare(annotation: object) -> object:
    return get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation


def _command_line(info: FieldInfo) -> CommandLine:
    return next((entry for entry in info.metadata if isinstance(entry, CommandLine)), CommandLine())
