"""Checks of the arguments of public functions, once at the boundary: types, numeric arrays, shapes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import cache, lru_cache
from types import MappingProxyType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from grasp_refine.core.errors import GraspRefineError, quote_value

SOURCES = MappingProxyType(
    {
        "Hand": "load_hand({})",
        "Object": "load_object({})",
        "Body": "load_object({}).body",
        "GraspSet": "load_grasps({})",
        "HandModel": "model_of(hand)",
        "World": "build_world(model_of(hand), obj, task)",
        "Motion": "closing_motion(scene)",
        "Witness": "query(pairs, T_world_a, T_world_b)",
    }
)
"""Type of an argument -> call that returns one, given a name or a path."""


def check_kind(name: str, value: object, kind: Any) -> None:
    """Refuse an argument of another type.

    Args:
        name: Name of the argument, for the message.
        value: The argument.
        kind: A class or an annotation such as `float | None`, `Literal["a", "b"]` or `tuple[float, ...]`. NaN is not
            a float, and True not a number.

    Raises:
        GraspRefineError: names the required type, the value given, and the function that returns such a value.
    """
    if not _test_of(kind)(value):
        source = SOURCES.get(getattr(next(iter(get_args(kind)), kind), "__name__", ""))
        shown = f'"{value}"' if isinstance(value, str) else "..."
        advice = f"; {source.format(shown)} returns one" if source else ""
        raise GraspRefineError(f"{name} must be {_describe(kind)}, got {describe_value(value)}{advice}")


def check_fields(settings: Any) -> None:
    """Refuse fields of a dataclass that are not of their annotated types; lists become tuples.

    Raises:
        GraspRefineError: names the class and the field.
    """
    settings_class: type = type(settings)
    for name, kind in _field_kinds(settings_class):
        value = getattr(settings, name)
        if isinstance(value, list) and get_origin(kind) is tuple:
            value = tuple(value)
            object.__setattr__(settings, name, value)
        check_kind(f"{type(settings).__name__}: {name}", value, kind)


def check_values(settings_class: type, values: Mapping[str, Any], prefix: str = "") -> None:
    """Refuse values of fields of a dataclass, by name, that are not of the annotated types.

    Raises:
        GraspRefineError: names the field, after the prefix.
    """
    kinds = dict(_field_kinds(settings_class))
    for name, value in values.items():
        check_kind(f"{prefix}{name}", value, kinds[name])


def check_positive(settings: Any, *names: str) -> None:
    """Check the fields as in `check_fields`, and refuse fields in `names` that are not above 0 and finite.

    Raises:
        GraspRefineError: names the class and the field.
    """
    check_fields(settings)
    for name in names:
        value = getattr(settings, name)
        if value is not None and not 0 < value < float("inf"):
            raise GraspRefineError(f"{type(settings).__name__}: {name} must be above 0 and finite, got {value:g}")


def as_numbers(name: str, value: Any, *shape: int | str, why: str = "") -> np.ndarray:
    """Return an argument as float64 array: numbers, nested lists, NumPy arrays, torch tensors with or without a graph.

    Args:
        name: Name of the argument, for the message.
        value: The argument.
        shape: Required shape; a string stands for any length; empty: any shape.
        why: Reason, added to the message about a wrong shape.

    Raises:
        GraspRefineError: not numeric, or another shape.
    """
    if not (isinstance(value, np.ndarray) and value.dtype == np.float64):
        value = _to_float64(name, value)
    if shape and not _has_shape(value, shape):
        raise shape_error(name, value, shape, why)
    return value


def check_shape(name: str, array: Any, *shape: int | str, why: str = "") -> None:
    """Refuse an array or tensor of another shape; a string stands for any length, "..." for any leading dimensions.

    Raises:
        GraspRefineError: names both shapes; or it is not an array.
    """
    if not hasattr(array, "shape"):
        raise GraspRefineError(f"{name} must be a NumPy array or a torch tensor, got {describe_value(array)}")
    if not _has_shape(array, shape):
        raise shape_error(name, array, shape, why)


def check_alike(*arrays: Any) -> None:
    """Refuse a mix of NumPy arrays and torch tensors.

    Raises:
        GraspRefineError: both are given.
    """
    if len({isinstance(array, np.ndarray) for array in arrays}) > 1:
        raise GraspRefineError("NumPy arrays and torch tensors cannot be mixed: give all as one or the other")


def shape_error(name: str, array: Any, shape: tuple[int | str, ...], why: str = "") -> GraspRefineError:
    """Return the error for an array of another shape than required."""
    wanted = ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "")
    return GraspRefineError(f"{name} must have shape ({wanted}), got {tuple(array.shape)}{why and f': {why}'}")


def is_number(value: object) -> bool:
    """Return whether a value is a single number other than NaN."""
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return bool(number and value == value)


def describe_value(value: object) -> str:
    """Return a value for a message: small ones in full, others by type and size."""
    if isinstance(value, type):
        return f"the class {value.__name__} itself"
    if hasattr(value, "shape"):
        return f"{type(value).__name__} of shape {tuple(value.shape)}"
    if isinstance(value, tuple | list | dict) and len(text := quote_value(value)) > 60:
        return f"{type(value).__name__} of {len(value)}: {text[:60]}..."
    if value is None or isinstance(value, bool | int | float | str | bytes | tuple | list | dict):
        return quote_value(value)
    return f"{type(value).__name__} {quote_value(str(value))}" if hasattr(value, "__fspath__") else type(value).__name__


def _to_float64(name: str, value: Any) -> np.ndarray:
    if hasattr(value, "detach"):  # a tensor; torch is not loaded to find out
        value = value.detach().cpu()
        value = value.double() if value.is_floating_point() else value
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):
        array = np.asarray(None)
    if array.dtype.kind not in "fiu":
        dtype = f" of {array.dtype}" if isinstance(value, np.ndarray) else ""
        raise GraspRefineError(f"{name} must be an array of numbers, got {describe_value(value)}{dtype}")
    return array.astype(np.float64)


def _has_shape(array: Any, shape: tuple[int | str, ...]) -> bool:
    have = array.shape
    if shape[0] == "...":
        have, shape = have[max(len(have) - len(shape) + 1, 0) :], shape[1:]
    return len(have) == len(shape) and all(
        isinstance(wanted, str) or wanted == length for wanted, length in zip(shape, have, strict=True)
    )


@lru_cache
def _field_kinds(settings: type) -> tuple[tuple[str, Any], ...]:
    hints = get_type_hints(settings)
    return tuple((field.name, hints[field.name]) for field in fields(settings))


@cache
def _test_of(kind: Any) -> Callable[[Any], bool]:
    """Return the test whether a value is of a kind."""
    origin, parts = get_origin(kind), get_args(kind)
    if kind in (Any, object):
        return lambda value: True
    if origin in (Union, UnionType):
        tests = tuple(map(_test_of, parts))
        return lambda value: any(test(value) for test in tests)
    if origin is Literal:
        return lambda value: isinstance(value, str) and value in parts
    if origin is tuple:
        tests = tuple(_test_of(part) for part in parts if part is not Ellipsis)
        if parts[-1] is Ellipsis:
            return lambda value: isinstance(value, tuple) and all(map(tests[0], value))
        return lambda value: (
            isinstance(value, tuple)
            and len(value) == len(tests)
            and all(test(item) for test, item in zip(tests, value, strict=True))
        )
    if origin is Callable:
        return callable
    if kind is float:
        return is_number
    if kind is int:
        return lambda value: isinstance(value, int | np.integer) and not isinstance(value, bool)
    if kind is bool:
        return lambda value: isinstance(value, bool | np.bool_)
    # A class has the methods of its instances, which is all that a protocol checks.
    return lambda value: isinstance(value, origin or kind) and not isinstance(value, type)


def _describe(kind: Any) -> str:
    """Return a type in words."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return " or ".join(map(_describe, parts))
    if origin is Literal:
        return f"one of {', '.join(map(repr, parts))}"
    if origin is tuple:
        described = [_describe(part) for part in parts if part is not Ellipsis]
        return f"a tuple, each {described[0]}" if parts[-1] is Ellipsis else f"a tuple of {', '.join(described)}"
    if kind in _KIND_WORDS:
        return _KIND_WORDS[kind]
    if origin is Callable:
        return "a function"
    name = getattr(origin or kind, "__name__", str(kind))
    article = "an" if name[0] in "AEIOU" else "a"
    return f"{article} {'torch.' if kind.__module__ == 'torch' else ''}{name}"


_KIND_WORDS = MappingProxyType(
    {float: "a number", int: "an integer", bool: "True or False", str: "a string", type(None): "None"}
)
