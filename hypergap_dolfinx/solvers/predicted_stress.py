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

        The stress S = F⁻¹P is that of the residual alone: P_ij is its integrand for v = e_i x_j,
        without x_j times that for v = e_i.
        """
        u, domain, n = self._u, F.ufl_domain(), len(self._u)
        v, du, x = (
            F.arguments()[0],
            ufl.TrialFunction(u.function_space),
            ufl.SpatialCoordinate(domain),
        )
        found = []
        for integral in F.integrals_by_type("cell"):
            units = [ufl.as_vector([float(i == k) for k in range(n)]) for i in range(n)]
            forces = [ufl.replace(integral.integrand(), {v: e}) for e in units]
            P = [
                [ufl.replace(integral.integrand(), {v: x[j] * e}) - x[j] * f for j in range(n)]
                for e, f in zip(units, forces, strict=True)
            ]
            S = ufl.inv(ufl.Identity(n) + ufl.grad(u)) * ufl.as_matrix(P)
            before = ufl.replace(S, {u: self._at})
            change = before + ufl.derivative(before, self._at, self._step) - S
            added = ufl.inner(ufl.grad(du) * change, ufl.grad(v))
            found.append(integral.reconstruct(integrand=added))
        return ufl.Form(found)
