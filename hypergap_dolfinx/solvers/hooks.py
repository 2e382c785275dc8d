# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bodies with a history: callbacks around Newton steps, and internal variables."""

import inspect
from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from hypergap_dolfinx.core.collective import run_on_all

CALLED = {"before_step": "()", "accepted": "(share)", "taken_back": "()"}
"""Arguments with which each callback is called."""


class Hooks:
    """Callbacks of a problem and internal variables of its state."""

    def __init__(
        self,
        internal_variables: Sequence[fem.Function | fem.Constant] = (),
        *,
        unknowns: Sequence[fem.Function] = (),
        before_step: Callable[[], Any] | None = None,
        accepted: Callable[[float], Any] | None = None,
        taken_back: Callable[[], Any] | None = None,
    ):
        """Check the callbacks and variables.

        Args:
            internal_variables: Functions and constants that the callbacks change.
            unknowns: The solution of each body.
            before_step: Called before a residual is evaluated at new displacements.
            accepted: Called with the part of the load step that is reached.
            taken_back: Called after a failed part of a load step.

        Raises:
            ValueError: A callback that isn't callable, or with other arguments; internal variables
                of another type.
        """
        hooks = {"before_step": before_step, "accepted": accepted, "taken_back": taken_back}
        for name, hook in hooks.items():
            if hook is not None and not callable(hook):
                raise ValueError(
                    f"{name} is a {type(hook).__name__}; give a function, which is called."
                )
            if hook is not None and not _takes(hook, len(CALLED[name][1:-1].split())):
                raise ValueError(
                    f"{name} takes other arguments than those it is called with: make it a "
                    f"function {name}{CALLED[name]}."
                )
        single = not isinstance(internal_variables, Sequence)
        variables: list[Any] = [internal_variables] if single else list(internal_variables)
        wrong = [v for v in variables if not isinstance(v, fem.Function | fem.Constant)]
        if wrong:
            raise ValueError(
                f"internal_variables has a {type(wrong[0]).__name__}; give functions and constants "
                "that are in the forms."
            )
        solved = next((i for i, u in enumerate(unknowns) if any(u is v for v in variables)), None)
        if solved is not None:
            raise ValueError(
                f"internal_variables has u[{solved}], which the problem finds and keeps by itself: "
                "leave it out."
            )
        self.comm, self._hooks = MPI.COMM_SELF, hooks
        self.internal_variables: list[fem.Function | fem.Constant] = variables
        """Functions and constants that belong to the state."""

    def __call__(self, name: str, *args):
        """Call a hook, if there is one. Collective.

        Raises:
            Exception: What it raises on any rank, on all of them.
        """
        hook = self._hooks[name]
        if hook is not None:
            run_on_all(self.comm, f"{name} failed", lambda: hook(*args))

    def has(self, name: str) -> bool:
        """True if there is a hook of this name."""
        return self._hooks[name] is not None

    @property
    def _arrays(self) -> list[npt.NDArray]:
        every = self.internal_variables
        return [v.x.array if isinstance(v, fem.Function) else v.value for v in every]

    def copies(self) -> list[npt.NDArray]:
        """Copies of the internal variables' values, ghosts included."""
        return [np.array(array) for array in self._arrays]

    def restore(self, copies: Sequence[npt.NDArray]):
        """Set the internal variables to copies."""
        for array, copy in zip(self._arrays, copies, strict=True):
            array[...] = copy


def _takes(hook: Callable, num: int) -> bool:
    """True if a function can be called with so many arguments, or doesn't say."""
    try:
        inspect.signature(hook).bind(*range(num))
    except TypeError:
        return False
    except ValueError:  # compiled ones have no signature
        pass
    return True
