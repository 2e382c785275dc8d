# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The state of a problem between two load steps, in memory and in files."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx.la
from hypergap_dolfinx.algebra.input_order import InputOrder, RowOrder
from hypergap_dolfinx.algebra.tolerances import NOTHING
from hypergap_dolfinx.core.collective import raise_on_all
from hypergap_dolfinx.surface.moving import Displacements, MovingSurface


class State:
    """State of a problem between two load steps.

    ``problem.state()`` makes it, ``problem.restore(state)`` restores it: in the same problem, or in
    one that the same script made in another process, on any number of ranks. Its arrays are on rank
    0, in the order of the input cells and nodes of the meshes. A mesh from the same file or the
    same call has the same order.

    Example:
        Continuation of a run that ended with ``problem.state().save("state.npz")``::

            problem.restore(State.load("state.npz", comm))
    """

    def __init__(self, comm: MPI.Comm, arrays: dict[str, npt.NDArray]):
        """Store the arrays.

        Args:
            comm: Communicator of the problem.
            arrays: All arrays by name on rank 0; empty on other ranks.
        """
        self.comm, self.arrays = comm, arrays

    def save(self, path: str | os.PathLike):
        """Write a NumPy file (``.npz``), completely or not at all. Collective.

        Args:
            path: Name of the file.

        Raises:
            OSError: The file can't be written; raised on all ranks.
            ValueError: Something that isn't a name.
        """
        path, error = _path(path, "save"), None
        if self.comm.rank == 0:
            part = path.with_name(path.name + ".part")
            try:
                with open(part, "wb") as file:
                    np.savez(file, **self.arrays)  # type: ignore[arg-type]
                part.replace(path)
            except OSError as e:
                error = f"no state is written to {path}: {e.strerror or e}."
        raise_on_all(self.comm, error, OSError)

    @classmethod
    def load(cls, path: str | os.PathLike, comm: MPI.Comm = MPI.COMM_WORLD) -> "State":
        """Read a file. Collective.

        Args:
            path: Name of the file.
            comm: Communicator of the problem that continues.

        Returns:
            The state.

        Raises:
            OSError: The file can't be read, or has no state; raised on all ranks.
            ValueError: Something that isn't a name, or isn't a communicator.
        """
        path, arrays, error = _path(path, "load"), dict[str, npt.NDArray](), None
        if not isinstance(comm, MPI.Comm):
            raise ValueError(f"load takes a file and a communicator, not {comm!r}: give mesh.comm.")
        if comm.rank == 0:
            try:
                with np.load(path) as file:
                    arrays = {name: file[name] for name in file.files}
                if "problem" not in arrays:
                    error = f"{path} is no state of a problem; give a file of state.save."
            except OSError as e:
                error = f"no state is read from {path}: {e.strerror or e}."
            except (ValueError, AttributeError, EOFError):
                error = f"{path} is no state of a problem; give a file of state.save."
        raise_on_all(comm, error, OSError)
        return cls(comm, arrays)


class Resumes(Protocol):
    """A contact's rows in a problem."""

    start: Displacements | None

    @property
    def sides(self) -> tuple[MovingSurface, MovingSurface]:
        """Γ0 and Γ1."""

    @property
    def kept(self) -> dict[str, npt.NDArray]:
        """Arrays on which the next load step depends."""

    def resume(self, kept: dict[str, npt.NDArray], start: Displacements | None) -> None:
        """Continue from retained arrays."""


@dataclass
class Part:
    """One array of a state; both functions are collective."""

    name: str
    gathered: Callable[[], npt.NDArray | None]
    """The array on rank 0, None on others."""
    take: Callable[[npt.NDArray | None], Any]
    """Sets it from rank 0's."""


class Checkpoint:
    """Parts of a problem's state."""

    def __init__(self, comm: MPI.Comm):
        """Start without any."""
        self.comm = comm
        self._orders: list[tuple[Any, InputOrder]] = []

    def order(self, V: Any) -> InputOrder:
        """Order of the dofs of a space. Collective when new."""
        compiled = getattr(V, "_cpp_object", V)
        order = next((order for known, order in self._orders if known is compiled), None)
        if order is None:
            order = InputOrder(compiled)
            self._orders.append((compiled, order))
        return order

    def shared(self, name: str, get: Callable[[], Any], put: Callable[[npt.NDArray], Any]) -> Part:
        """An array that is the same on all ranks."""
        return Part(
            name,
            lambda: np.array(get()) if self.comm.rank == 0 else None,
            lambda values: put(self.comm.bcast(values)),
        )

    def function(self, name: str, f: Any) -> Part:
        """A function's values, or those of a constant or an array."""
        if not hasattr(f, "x"):
            array = f if isinstance(f, np.ndarray) else f.value

            def put(values: npt.NDArray):
                array[...] = values

            return self.shared(name, lambda: array, put)
        order = self.order(f.function_space)

        def take(values: npt.NDArray | None):
            f.x.array[: order.size_local] = order.scattered(values)
            vector = f.x if isinstance(f.x, dolfinx.la.Vector) else dolfinx.la.Vector(f.x)
            vector.scatter_forward()

        return Part(name, lambda: order.gathered(f.x.array), take)

    def start(self, name: str, f: Any, start: npt.NDArray) -> Part:
        """Values that a function, a constant or an array had before."""
        array, part = (f.x.array if hasattr(f, "x") else start), self.function(name, f)
        if array is start:

            def put(values: npt.NDArray):
                start[...] = values

            return self.shared(name, lambda: start, put)
        order = self.order(f.function_space)

        def take(values: npt.NDArray | None):
            now = array.copy()
            part.take(values)
            start[:], array[:] = array, now

        return Part(name, lambda: order.gathered(start), take)

    def mesh(self, name: str, V: Any) -> Part:
        """The mesh of a space, which is only compared."""
        found = self.order(V).fingerprint()

        def compare(values: npt.NDArray):
            if not np.allclose(values, found, rtol=0, atol=NOTHING * max(1, found[0])):
                raise ValueError(
                    f"the state is of another mesh than {name}, or of one whose cells were given "
                    "in another order: make it from the same file, or by the same call."
                )

        return self.shared(name, lambda: found, compare)

    def rows(self, name: str, order: RowOrder, vector: Any, kept: list[str]) -> list[Part]:
        """A vector of multipliers, or of what else belongs to ties.

        Args:
            name: Name of the tie.
            order: Order of its entries.
            vector: The vector.
            kept: Takes the names of ties whose multipliers aren't found again.
        """
        known = [True]

        def compare(key: npt.NDArray):
            same = False
            if order.key is not None and order.key.shape == key.shape:
                same = np.allclose(order.key, key, rtol=0, atol=NOTHING * np.abs(key).max())
            known[0] = self.comm.bcast(same)
            if not known[0]:
                kept.append(name)

        def take(values: npt.NDArray | None):
            if known[0]:
                vector.array[:] = order.scattered(values)
            else:
                vector.set(0.0)

        def key():
            return np.zeros(0) if order.key is None else order.key

        return [
            self.shared(f"{name}/rows", key, compare),
            Part(name, lambda: order.gathered(vector.array_r), take),
        ]

    def contact(self, name: str, rows: Resumes, orders: Sequence[InputOrder]) -> list[Part]:
        """Arrays of a contact.

        Args:
            name: Name of the contact.
            rows: The contact.
            orders: Orders of the dofs of both sides' bodies.
        """
        kept = dict[str, npt.NDArray]()

        def part(key: str) -> Part:
            return self.shared(
                f"{name}/{key}", lambda: rows.kept[key], lambda values: kept.update({key: values})
            )

        def sorts() -> list[npt.NDArray[np.intp]]:
            pairs = zip(orders, rows.sides, strict=True)
            return [np.argsort(order.places(side.dofs)) for order, side in pairs]

        def start() -> npt.NDArray | None:
            if self.comm.rank > 0:
                return None
            if rows.start is None:
                return np.zeros((0, 0))
            return np.concatenate([u[s] for u, s in zip(rows.start, sorts(), strict=True)])

        def resume(values: npt.NDArray | None):
            found = None
            if values is not None and len(values):
                found = [np.empty_like(u) for u in np.split(values, [len(rows.sides[0].dofs)])]
                for u, s, part in zip(found, sorts(), np.split(values, [len(found[0])])):
                    u[s] = part
            found = self.comm.bcast(found)
            rows.resume(kept, None if found is None else (found[0], found[1]))

        return [*map(part, rows.kept), Part(f"{name}/start", start, resume)]

    def state(self, kind: str, parts: Sequence[Part]) -> State:
        """Gather all parts. Collective."""
        arrays = {"problem": np.array(kind)}
        for part in parts:
            found = part.gathered()
            if found is not None:
                arrays[part.name] = found
        return State(self.comm, arrays if self.comm.rank == 0 else {})

    def restore(self, kind: str, parts: Sequence[Part], state: State):
        """Check a state, and take its parts. Collective.

        Raises:
            ValueError: It is of another problem.
        """
        if not isinstance(state, State):
            raise ValueError(
                f"restore takes a State, of problem.state() or State.load(…), not a "
                f"{type(state).__name__}."
            )
        error = None
        now = self.state(kind, parts).arrays
        if self.comm.rank == 0:
            error = _difference(state.arrays, now)
        raise_on_all(self.comm, error, ValueError)
        for part in parts:
            part.take(state.arrays.get(part.name))


def _path(path: str | os.PathLike, call: str) -> Path:
    """The path of a file.

    Raises:
        ValueError: Something that isn't a name.
    """
    if not isinstance(path, str | os.PathLike):
        raise ValueError(f"{call} takes the name of a file, not a {type(path).__name__}.")
    return Path(path)


def _difference(given: dict[str, npt.NDArray], now: dict[str, npt.NDArray]) -> str | None:
    """Reason why a state doesn't fit, or None."""
    if str(given["problem"]) != str(now["problem"]):
        return f"the state is one of a {given['problem']}, not of a {now['problem']}."
    for name in sorted(given.keys() ^ now.keys()):
        has, lacks = ("state", "problem") if name in given else ("problem", "state")
        return f"the {has} has {name} and the {lacks} hasn't: it is a state of another problem."
    for name, array in given.items():
        if name.endswith(("/rows", "/start")) or name == "problem":
            continue
        other = now[name]
        if array.shape != other.shape or not np.can_cast(array.dtype, other.dtype, "same_kind"):
            return (
                f"{name} has shape {array.shape} ({array.dtype}) in the state and {other.shape} "
                f"({other.dtype}) in the problem: it is a state of another problem."
            )
    return None
