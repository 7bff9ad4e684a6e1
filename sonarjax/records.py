"""`record`: frozen dataclasses as JAX pytrees that are rebuilt without calling their constructor.

A constructor may broadcast, convert or check what a user gives it. JAX rebuilds a record from tracers, shape structs
and placeholders, which must pass through unchanged. Fields marked by `static()` decide shapes and are not leaves.
Records are equal if all their values are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, TypeVar, dataclass_transform

import jax
import numpy as np

T = TypeVar("T")


def static(**options: Any) -> Any:
    """Declare a field of a record that is not a leaf.

    Its value is hashed, and another value means other compiled code.

    Args:
        **options: Passed on to `dataclasses.field`, such as `default`.

    Returns:
        The field.
    """
    return dataclasses.field(**options, metadata={"static": True})


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field, static))
def record(cls: type[T]) -> type[T]:
    """Make a class a frozen dataclass and a pytree with named leaves.

    Args:
        cls: The class, with annotated fields.

    Returns:
        The dataclass, registered with JAX.
    """
    made: Any = dataclasses.dataclass(frozen=True)(cls)
    fields = dataclasses.fields(made)
    leaves = tuple(f.name for f in fields if not f.metadata.get("static", False))
    fixed = tuple(f.name for f in fields if f.metadata.get("static", False))

    def flatten_with_keys(value: Any) -> tuple[Any, Any]:
        keyed = tuple((jax.tree_util.GetAttrKey(name), getattr(value, name)) for name in leaves)
        return keyed, tuple(getattr(value, name) for name in fixed)

    def flatten(value: Any) -> tuple[Any, Any]:
        return tuple(getattr(value, name) for name in leaves), tuple(getattr(value, name) for name in fixed)

    def unflatten(aux: Any, children: Any) -> Any:
        value = object.__new__(made)
        for name, child in zip((*leaves, *fixed), (*children, *aux), strict=True):
            object.__setattr__(value, name, child)
        return value

    jax.tree_util.register_pytree_with_keys(made, flatten_with_keys, unflatten, flatten)
    made.__eq__ = _equal_by(made.__eq__)  # the dataclass's hash stays: it fails for arrays, as theirs does
    return made


def _equal_by(usual: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Compare records by value. Traced ones are left to the dataclass's `usual` comparison, which raises JAX's error;
    arrays have no single truth value, so that it fails for them too.
    """

    def equal(one: Any, other: Any) -> Any:
        if one is other or other.__class__ is not one.__class__:
            return one is other or NotImplemented
        flat: tuple[Any, Any] = jax.tree.flatten(one), jax.tree.flatten(other)
        (left, shape), (right, other_shape) = flat
        if any(isinstance(leaf, jax.core.Tracer) for leaf in (*left, *right)):
            return usual(one, other)
        return shape == other_shape and all(a is b or np.array_equal(a, b) for a, b in zip(left, right, strict=True))

    return equal
