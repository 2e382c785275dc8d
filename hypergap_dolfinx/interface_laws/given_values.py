# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Values on an interface as users give them: numbers, or objects that are read anew each time."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from hypergap_dolfinx.surface.tolerances import NOISE

PACKAGE = __name__.partition(".")[0]

Given = npt.ArrayLike | fem.Constant | fem.Function | Callable[[npt.NDArray], Any]


class Settable:
    """Base class of what users make: once it is made, names that can't be set are refused.

    Classes that users derive may have attributes of their own.
    """

    def __setattr__(self, name: str, value: Any):
        """Set an attribute; only a property with a setter after ``_made`` is set.

        Raises:
            AttributeError: Another one, such as a misspelt name.
        """
        is_made = not name.startswith("_") and self.__dict__.get("_made", False)
        if is_made and type(self).__module__.partition(".")[0] == PACKAGE:
            properties = {key: getattr(type(self), key) for key in dir(type(self))}
            can = [key for key, one in properties.items() if getattr(one, "fset", None)]
            if name not in can:
                advice = f"{', '.join(can)} can" if can else "nothing can: make another one"
                raise AttributeError(f"{name} of a {type(self).__name__} can't be set; {advice}.")
        super().__setattr__(name, value)


def as_moduli(stiffness: Any) -> tuple[float, float]:
    """The moduli of two bodies.

    Raises:
        ValueError: They aren't two numbers above 0.
    """
    try:
        first, second = as_numbers(stiffness, (2,), "stiffness").tolist()
    except ValueError:
        first = second = 0.0
    if not (first > 0 and second > 0):
        raise ValueError(f"stiffness is a pair of moduli > 0, not {stiffness!r}.")
    return first, second


def is_read(value: Any) -> bool:
    """True for values that are read anew each time: a function, a constant, or a callable of x."""
    if isinstance(value, fem.Constant | fem.Function):
        return True
    return callable(value) and not isinstance(value, ufl.core.expr.Expr | type)  # UFL's are too


def changing(*values: Any) -> list[fem.Function | fem.Constant]:
    """Objects among them in which a user changes values."""
    return [v for v in values if isinstance(v, fem.Function | fem.Constant)]


def check(value: Any, what: str):
    """Refuse objects that can't be values on an interface.

    Args:
        value: The object.
        what: Its name in the message.

    Raises:
        ValueError: Names its type.
    """
    wrong = None if is_read(value) else _no_number(value)
    if wrong:
        raise ValueError(
            f"{what} is given as numbers, a fem.Constant, a fem.Function or a callable of x, not "
            f"as {wrong}; interpolate expressions into a function first."
        )


def as_numbers(value: Any, shape: tuple[int, ...], what: str) -> npt.NDArray[np.float64]:
    """Finite numbers of a shape; a single one without a list too.

    Args:
        value: The numbers.
        shape: Their shape.
        what: Their name in the message.

    Raises:
        ValueError: Something else.
    """
    try:
        found = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        found = np.full(0, np.nan)
    if isinstance(value, ufl.core.expr.Expr):  # a constant, which wouldn't be read again
        found = np.full(0, np.nan)
    if found.size == np.prod(shape) == 1:
        found = found.reshape(shape)
    if found.shape != shape or not np.isfinite(found).all():
        num = int(np.prod(shape))
        wanted = "one finite number" if num == 1 else f"{num} finite numbers"
        raise ValueError(f"{what}: give {wanted}, not {value!r}.".replace("\n", ""))
    return found


def at_points(function: Callable[[npt.NDArray], Any], x: npt.NDArray) -> Any:
    """Values of a callable at points x, ``(num_points, n)``.

    Raises:
        ValueError: The values are no numbers.
    """
    values = function(np.vstack((x.T, np.zeros((3 - x.shape[1], len(x))))))
    wrong = _no_number(values)
    if wrong:
        raise ValueError(f"the callable gives {wrong}, not numbers.")
    return values


def each(values: npt.ArrayLike, num: int) -> npt.NDArray:
    """One value at all points, or one at each; a ValueError for another number of values."""
    values = np.asarray(values)
    if values.shape not in ((), (1,), (num,)):
        raise ValueError(f"the callable gives {values.shape} values at {num} points.")
    return np.broadcast_to(values, num)


def without_round_off(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Values of a function that is nowhere negative: where it vanishes it may be −1e-17."""
    least = -NOISE * np.abs(values).max(initial=0)
    return np.where((values < 0) & (values >= least), 0, values)


def _no_number(value: Any) -> str | None:
    """Type of the first entry that is no number. Entry by entry, since NumPy iterates UFL's."""
    if isinstance(value, list | tuple):
        wrong = next(filter(None, map(_no_number, value)), None)
        return wrong and f"a {type(value).__name__} with {wrong}"
    if isinstance(value, ufl.core.expr.Expr):
        known = isinstance(value, fem.Constant | fem.Function)
        return f"a {type(value).__name__}" if known else "a UFL expression"
    dtype = value.dtype if isinstance(value, np.ndarray) else np.asarray(value).dtype
    return None if np.issubdtype(dtype, np.number) else type(value).__name__
