"""Signatures of classes as they are called, for the reference.

A class whose `__init__` equinox makes of its fields has none in the source; the one
that it has when it is imported is put there. Results, which nobody calls, get none.
What an `__init__` says of itself is left out: the class says it.
"""

import enum
import importlib
import inspect
from typing import Any

import equinox as eqx
import griffe

from ziegler_jax.results import AbstractResult


class EquinoxFields(griffe.Extension):
    """Gives each class the signature by which it is called."""

    def on_package(self, *, pkg: griffe.Module, **kwargs: Any) -> None:
        """Walk the package once it is loaded."""
        del kwargs
        for module in [pkg, *_modules(pkg)]:
            for class_ in module.classes.values():
                if not class_.is_alias:
                    _complete(class_)


def _modules(module: griffe.Module) -> list[griffe.Module]:
    inner = [m for m in module.modules.values() if not m.is_alias]
    return [*inner, *(below for m in inner for below in _modules(m))]


def _complete(class_: griffe.Class) -> None:
    if "__init__" in class_.members:
        class_.members["__init__"].docstring = None
        return
    real = getattr(importlib.import_module(class_.module.path), class_.name)
    uncalled = issubclass(real, AbstractResult | enum.Enum) or inspect.isabstract(real)
    if uncalled or not issubclass(real, eqx.Module | tuple):
        return
    self_ = griffe.Parameter("self", kind=griffe.ParameterKind.positional_or_keyword)
    parameters = [
        griffe.Parameter(
            name,
            kind=getattr(griffe.ParameterKind, parameter.kind.name.lower()),
            default=None
            if parameter.default is parameter.empty
            else repr(parameter.default),
        )
        for name, parameter in inspect.signature(real).parameters.items()
    ]
    init = griffe.Function("__init__", parameters=griffe.Parameters(self_, *parameters))
    class_.set_member("__init__", init)
