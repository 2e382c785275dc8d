# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Geometric stiffness of slender bodies, with the stress that Newton's last step predicted.

A step d goes straight where points go around, and so stretches a slender body by ½|∇d|², of which
the linearised problem knew nothing. The stress of that is in the next tangent's geometric
stiffness, ∫ ∇du S : ∇v, where it is more than the body's bending stiffness: steps become long and
short in turn. With the stress that the last tangent predicted, S(u₀) + ∂S(u₀)(u − u₀), the matrix
is that of a mixed formulation, with stresses as unknowns (Magisano, Leonetti and Garcea, Comput.
Methods Appl. Mech. Engrg. 313 (2017) 986–1005). Residuals, and so solutions, are the same.
"""

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem
from hypergap_dolfinx.core.forms import thickness
from hypergap_dolfinx.solvers.tolerances import SLENDER


def is_slender(u: fem.Function) -> bool:
    """True if a body is far longer than thick. Collective."""
    mesh = u.function_space.mesh
    x = mesh.geometry.x
    ends = np.stack((x.max(axis=0, initial=-np.inf), -x.min(axis=0, initial=np.inf)))
    mesh.comm.Allreduce(MPI.IN_PLACE, ends, MPI.MAX)
    return bool(np.linalg.norm(ends.sum(axis=0)) > SLENDER * thickness(mesh))


class PredictedStress:
    """Predicted stress of a body, from its residual and displacement."""

    def __init__(self, u: fem.Function):
        """Start at the present displacement."""
        self._u = u
        self._at, self._step = (fem.Function(u.function_space) for _ in range(2))
        self.start()

    def start(self):
        """Forget the last tangent: the stress is the present one."""
        self._at.x.array[:] = self._u.x.array
        self._step.x.array[:] = 0.0

    def update(self):
        """Predict the present stress from the place of the last tangent."""
        self._at.x.array[:] += self._step.x.array
        self._step.x.array[:] = self._u.x.array - self._at.x.array

    def stiffness(self, F: ufl.Form) -> ufl.Form:
        """Difference that the prediction makes in a residual's derivative, a form.

        The stress S = F⁻¹P is that of the residual alone: P_ij is its integrand for ∇v = e_i ⊗ e_j
        and v = 0. Its points are those of the residual's derivative: F⁻¹ would, by UFL's estimate,
        take many times as many.
        """
        u, n = self._u, len(self._u)
        v, du = F.arguments()[0], ufl.TrialFunction(u.function_space)
        none, found = ufl.zero(n), []
        e = [ufl.unit_vector(i, n) for i in range(n)]
        for integral in ufl.algorithms.expand_derivatives(F).integrals_by_type("cell"):
            forces = integral.integrand()
            P = ufl.as_matrix(
                [
                    [ufl.replace(forces, {ufl.grad(v): ufl.outer(a, b), v: none}) for b in e]
                    for a in e
                ]
            )
            if P == ufl.zero(n, n):
                continue
            S = ufl.inv(ufl.Identity(n) + ufl.grad(u)) * P
            before = ufl.replace(S, {u: self._at})
            change = before + ufl.derivative(before, self._at, self._step) - S
            added = ufl.inner(ufl.grad(du) * change, ufl.grad(v))
            points = {"quadrature_degree": _degree(integral, u), **integral.metadata()}
            found.append(integral.reconstruct(integrand=added, metadata=points))
        return ufl.Form(found)


def _degree(integral: ufl.Integral, u: fem.Function) -> int:
    """UFL's estimate of the degree of an integral's derivative, or, without u, of its own."""
    form = ufl.algorithms.expand_derivatives(ufl.derivative(ufl.Form([integral]), u))
    form = ufl.Form([integral]) if form.empty() else form
    data = ufl.algorithms.compute_form_data(form, do_apply_integral_scaling=True).integral_data
    return max(
        int(np.max(part.metadata()["estimated_polynomial_degree"]))
        for one in data
        for part in one.integrals
    )
