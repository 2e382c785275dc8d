# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""3D benchmarks: patch tests, the pressurised sphere, ranks."""

from itertools import product

from mpi4py import MPI

import numpy as np
import patch_test_3d
import pressurised_sphere as sphere
import pytest
from helpers import sweep

comm = MPI.COMM_WORLD


PATCHES = list(product(patch_test_3d.ELEMENTS["tetrahedron"], patch_test_3d.KINDS["tetrahedron"]))


@pytest.mark.parametrize("name, kind", sweep(PATCHES, 3))
def test_patch(name, kind):
    """Both tests to round-off; some of the cases (all of them with the demo)."""
    worst = 0.0
    cases = [case for case in patch_test_3d.cases() if case[1:3] == (name, kind)]
    cases = [case for case in cases if case[5] == (case[4][0] > case[4][1])]
    for test, elements, mesh, shape, ratio, swap in sweep(cases, 8):
        case = (patch_test_3d.pair(elements), mesh, shape, ratio, swap, test)
        worst = max(worst, *patch_test_3d.solve(comm, *case))
    print(worst)
    assert worst <= 1e-11


# Relative errors of the displacement, the stress (a prototype's, + 1 %) and the traction
PROTOTYPE = {
    (1, 0.1): (1.38e-2, 1.55e-1, 0.14),
    (1, 0.05): (3.48e-3, 7.70e-2, 0.072),
    (2, 0.2): (1.15e-3, 2.74e-2, 0.026),
    (2, 0.1): (1.47e-4, 7.10e-3, 7.5e-3),
}
NAMES = ("l2", "stress", "traction")
RATES = {1: (1.95, 0.97, 0.9), 2: (2.9, 1.9, 1.75)}


@pytest.mark.parametrize(
    "degree, h, swap", sweep(((1, 0.1, False), (1, 0.1, True), (2, 0.2, False), (2, 0.2, True)), 4)
)
def test_sphere(degree, h, swap):
    row, *_ = sphere.run(comm, h, degree, swap)
    print([row[name] for name in NAMES])
    for name, bound in zip(NAMES[:2], PROTOTYPE[degree, h], strict=False):
        assert row[name] <= 1.01 * bound
    assert row["traction"] <= (1.6 if swap else 1) * PROTOTYPE[degree, h][2]


@pytest.mark.slow
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("degree", (1, 2))
def test_rates_on_regenerated_meshes(degree, swap):
    hs = (0.1 * degree, 0.05 * degree)
    coarse, fine = (sphere.run(comm, h, degree, swap)[0] for h in hs)
    rates = [np.log2(coarse[name] / fine[name]) for name in NAMES]
    print(rates)
    assert all(r >= expected for r, expected in zip(rates, RATES[degree], strict=True))
    for name, bound in zip(NAMES[:2], PROTOTYPE[degree, hs[1]], strict=False):
        assert fine[name] <= 1.01 * bound


@pytest.mark.slow
@pytest.mark.parametrize("swap", (False, True))
@pytest.mark.parametrize("degree", (1, 2))
def test_rates_on_refined_meshes(degree, swap):
    """Where multipliers on triangles lock, λ diverges here."""
    h = 0.15 * degree
    coarse, fine = (sphere.run(comm, h / 2**r, degree, swap, r)[0] for r in (1, 2))
    rates = [np.log2(coarse[name] / fine[name]) for name in NAMES]
    print(rates)
    assert all(r >= expected for r, expected in zip(rates, RATES[degree], strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("adjust", (False, True))
@pytest.mark.parametrize("degree", (1, 2))
def test_as_accurate_as_one_fused_mesh(degree, adjust):
    """Flat facets of different size overlap: 3 % of L², gone when Γ1 is moved onto Γ0."""
    h = 0.05 * degree
    row, fused = sphere.run(comm, h, degree, False, 0, adjust)[0], sphere.run_fused(comm, h, degree)
    print(row["l2"] / fused["l2"], row["stress"] / fused["stress"])
    assert row["stress"] <= 1.02 * fused["stress"]
    assert row["l2"] <= (1.02 if adjust or degree > 1 else 1.04) * fused["l2"]


def gathered(u):
    """Displacements at all nodes, sorted by the nodes' places; on every rank."""
    V = u.function_space
    owned = V.dofmap.index_map.size_local
    x, values = V.tabulate_dof_coordinates()[:owned], u.x.array.reshape(-1, 3)[:owned]
    x, values = (np.vstack(V.mesh.comm.allgather(part)) for part in (x, values))
    return values[np.lexsort(np.round(x, 8).T)]


def difference(us, references):
    """Largest relative difference of the displacements."""
    a, b = (np.vstack([gathered(u) for u in functions]) for functions in (us, references))
    return np.abs(a - b).max() / np.abs(b).max()


@pytest.mark.ranks(degree=sweep((1, 2), 2))
@pytest.mark.parametrize("degree", (1, 2))
def test_same_on_any_number_of_ranks(degree):
    if comm.size == 1:
        pytest.skip("one rank is what several are compared with")
    us, references = (
        sphere.run(c, 0.2 * degree, degree, False)[1].u for c in (comm, MPI.COMM_SELF)
    )
    assert difference(us, references) <= 1e-11
