"""Fields in the reference without what only validation and the command line read: `Annotated[int, …]` is `int`."""

from __future__ import annotations

from typing import Any

from griffe import Attribute, Expr, ExprCall, ExprKeyword, ExprName, ExprSubscript, ExprTuple, Extension


class PlainTypes(Extension):
    """Takes the metadata off the annotations of attributes, as of the fields of an options model."""

    def on_attribute_instance(self, *, attr: Attribute, **_: Any) -> None:
        """Called with each attribute that is read."""
        attr.annotation, attr.value = _plain(attr.annotation, attr), _made(attr.value)


def _plain(annotation: str | Expr | None, attr: Attribute) -> str | Expr | None:
    if isinstance(annotation, ExprName) and annotation.name in attr.module.members:
        alias = attr.module.members[annotation.name]
        meant = alias.value if isinstance(alias, Attribute) else None
        return _plain(meant, attr) if _is_annotated(meant) else annotation
    if isinstance(annotation, ExprSubscript) and _is_annotated(annotation):
        return annotation.slice.elements[0] if isinstance(annotation.slice, ExprTuple) else annotation
    return annotation


def _is_annotated(annotation: object) -> bool:
    return isinstance(annotation, ExprSubscript) and str(annotation.left) == "Annotated"


def _made(value: str | Expr | None) -> str | Expr | None:
    """`dict()` in place of `Field(default_factory=dict)`."""
    arguments = value.arguments if isinstance(value, ExprCall) and str(value.function) == "Field" else ()
    factories = (a.value for a in arguments if isinstance(a, ExprKeyword) and a.name == "default_factory")
    return next((f"{factory}()" for factory in factories), value)
