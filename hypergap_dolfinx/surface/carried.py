# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A surface carried to another one by a rigid motion: periodic and cyclic ties.

Σ lies between Γ1 and the image of Γ0 under x ↦ R (x − c) + c + t, two surfaces that touch.
Components of a vector rotate with it: u₁ is compared with R u₀.
"""

from collections.abc import Hashable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.core.collective import spot
from hypergap_dolfinx.errors import InterfaceError
from hypergap_dolfinx.surface.tolerances import OFF_CARRIED, ORTHOGONAL, SAG_OUTLINE
from hypergap_dolfinx.surface.trace import Surface


@dataclass(frozen=True, eq=False)
class Motion:
    """A rigid motion x ↦ R (x − c) + c + t."""

    turn: npt.NDArray[np.float64]
    """R, ``(n, n)``."""
    centre: npt.NDArray[np.float64]
    """c, ``(n,)``."""
    shift: npt.NDArray[np.float64]
    """t, ``(n,)``."""

    @property
    def key(self) -> Hashable:
        """Key that is equal for equal motions."""
        return tuple(np.concatenate((self.turn.ravel(), self.centre, self.shift)).tolist())

    @property
    def turns(self) -> bool:
        """True if the motion has a rotation."""
        return bool((self.turn != np.eye(len(self.turn))).any())

    def __call__(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Images of points, ``(..., n)``."""
        if not self.turns:
            return x + self.shift
        return (x - self.centre) @ self.turn.T + self.centre + self.shift

    def of_components(self, shape: tuple[int, ...]) -> npt.NDArray[np.float64] | None:
        """R as it acts on the components of a field; None if they stay the same.

        Args:
            shape: The field's value shape.

        Raises:
            InterfaceError: Neither a scalar nor a vector with n components.
        """
        if shape == () or not self.turns:
            return None
        if shape != self.shift.shape:
            raise InterfaceError(
                f"a rotation turns vectors with {len(self.shift)} components and leaves scalars; "
                f"the value shape is {shape}."
            )
        return self.turn

    def __str__(self) -> str:
        """Name for messages."""
        return "the rotation" if self.turns else f"the translation {spot(self.shift)}"


def motion(
    n: int,
    translation: npt.ArrayLike | None,
    rotation: npt.ArrayLike | None,
    centre: npt.ArrayLike | None,
    axis: npt.ArrayLike | None,
) -> Motion:
    """The motion x ↦ x + t or x ↦ R (x − c) + c.

    Args:
        n: Number of coordinates.
        translation: t, or None.
        rotation: An angle in radians, counterclockwise (in space: seen against the axis), or R; or
            None.
        centre: c, a point on the axis; the origin if not given.
        axis: Direction of an angle's axis in space, of any length; z if not given.

    Raises:
        ValueError: Both or none are given, or no valid translation or rotation in n dimensions.
    """
    if (translation is None) == (rotation is None):
        raise ValueError("a periodic tie takes a translation or a rotation, one of them.")
    if rotation is not None:
        return _rotation(rotation, n, centre, axis)
    if not (centre is None and axis is None):
        raise ValueError("centre and axis belong to a rotation; none is given.")
    t = np.asarray(translation, dtype=np.float64)
    if t.shape != (n,) or not np.isfinite(t).all():
        raise ValueError(f"a translation is {n} numbers here, not {translation!r}.")
    return Motion(np.eye(n), np.zeros(n), t)


def _rotation(turn: npt.ArrayLike, n: int, centre, axis) -> Motion:
    """The motion x ↦ R (x − c) + c."""
    c = np.zeros(n) if centre is None else np.asarray(centre, dtype=np.float64)
    if c.shape != (n,) or not np.isfinite(c).all():
        raise ValueError(f"the centre of a rotation is {n} numbers here, not {centre!r}.")
    R = np.asarray(turn, dtype=np.float64)
    if axis is not None and (n == 2 or R.ndim):
        raise ValueError("a rotation has an axis where it is given as an angle in space.")
    if not R.ndim:
        R = _about(float(R), n, (0, 0, 1) if axis is None else axis)
    if R.shape != (n, n) or not np.abs(R.T @ R - np.eye(n)).max() <= ORTHOGONAL:
        raise ValueError(
            f"the matrix is no rotation: give {n} × {n} numbers with RᵀR = 1, or an angle."
        )
    if np.linalg.det(R) < 0:
        raise ValueError("the matrix is a reflection (det R = −1), not a rotation.")
    R = np.where(np.abs(R) < 4 * np.finfo(float).eps, 0, R)  # cos(π / 2) is 6e-17
    return Motion(R, c, np.zeros(n))


def _about(angle: float, n: int, axis: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """R of an angle, about an axis if n is 3."""
    if not abs(angle) <= 2 * np.pi:
        raise ValueError(f"the angle of a rotation is in radians, up to 2π; {angle:g} is not.")
    c, s = np.cos(angle), np.sin(angle)
    if n == 2:
        return np.array([[c, -s], [s, c]])
    a = np.asarray(axis, dtype=np.float64)
    if a.shape != (3,) or not np.isfinite(a).all() or not a.any():
        raise ValueError(f"the axis of a rotation is a direction in space, not {axis!r}.")
    a = a / np.linalg.norm(a)
    return c * np.eye(3) + (1 - c) * np.outer(a, a) + s * np.cross(np.eye(3), a)


def surface(own: Surface, motion: Motion, other: Surface) -> Surface:
    """The image of Γ0 (``own``) under a motion.

    Raises:
        InterfaceError: It does not coincide with Γ1 (``other``); the message says by how much.
    """
    nodes = None if own.own_nodes is None else motion(own.own_nodes)
    there = replace(own, x=motion(own.x), own_nodes=nodes)
    low = other.x.min(axis=0) - there.x.min(axis=0)
    high = other.x.max(axis=0) - there.x.max(axis=0)
    size = np.ptp(other.x, axis=0).max()
    off = (low + high) / 2
    alike = np.abs(high - low).max() <= OFF_CARRIED * size
    if alike and np.abs(off).max() > OFF_CARRIED * size:
        hint = "" if motion.turns else f"; {spot(motion.shift + off)} would not"
        raise InterfaceError(f"{motion} carries Γ0 beside Γ1: it misses by {spot(off)}{hint}.")
    miss = max(np.abs(low).max(), np.abs(high).max())
    if miss > SAG_OUTLINE * max(own.size.max(), other.size.max()):
        raise InterfaceError(
            f"{motion} carries Γ0 from {spot(there.x.min(axis=0))} … {spot(there.x.max(axis=0))}, "
            f"but Γ1 is from {spot(other.x.min(axis=0))} … {spot(other.x.max(axis=0))}: it misses "
            f"by {miss:.3g}."
        )
    return there
