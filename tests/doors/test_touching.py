# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which bodies touch, and with which facets."""

from itertools import pairwise, product

from mpi4py import MPI

import numpy as np
import pytest
from helpers import comm, raises, two_blocks

import basix.ufl
import dolfinx
import meshes
from dolfinx import fem
from hypergap_dolfinx import InterfaceError, find_touching
from hypergap_dolfinx.core import compat

PLANE, SPACE = ("triangle", "quadrilateral"), ("tetrahedron", "hexahedron")
# Facets as simplices, with the vertices in DOLFINx's order
SIMPLICES = {"tetrahedron": [[0, 1, 2]], "hexahedron": [[0, 1, 2], [1, 2, 3]]}


def space(n, low, high, cell, mapping=lambda x: x, c=comm, **options):
    """A space on a block from one corner to the other, mapped."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    options = {"cell": cell, **options}
    mesh, _ = meshes.block(c, n, lambda x: mapping(low + x * (high - low)), **options)
    return fem.functionspace(mesh, ("Lagrange", 1))


def ring(n, inner, outer, cell, degree=1, height=0, turned=0):
    """A ring around the z axis, in the plane or in space; n edges around."""

    def mapping(x):
        angle = 2 * np.pi * x[:, 1:2] + turned
        return np.hstack((x[:, :1] * np.cos(angle), x[:, :1] * np.sin(angle), x[:, 2:] + height))

    dim = 2 if cell in PLANE else 3
    low, high = ((r, end, end) for end, r in enumerate((inner, outer)))
    options = {"degree": degree, "periodic": True}
    return space((1, n, 2)[:dim], low[:dim], high[:dim], cell, mapping, **options)


def vertices(V, facets=None):
    """The vertices of exterior facets on all ranks, ``(num_facets, num_vertices, n)``."""
    mesh = V.mesh
    n = mesh.geometry.dim
    mesh.topology.create_connectivity(n - 1, n)
    if facets is None:
        facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    num = {"tetrahedron": 3, "hexahedron": 4}.get(mesh.topology.cell_name(), 2)
    nodes = compat.entities_to_geometry(mesh, n - 1, facets)[:, :num]
    x = np.concatenate(comm.allgather(mesh.geometry.x[nodes, :n]))
    return x[np.lexsort(x.mean(axis=1).T)]


def middles(V, facets):
    """The middles of facets on all ranks, in one order."""
    return vertices(V, facets).mean(axis=1)


def hit(V, points):
    """The middles of the exterior facets in which one of some points lies."""
    x = vertices(V)
    found = np.zeros(len(x), dtype=bool)
    for simplex in SIMPLICES.get(V.mesh.topology.cell_name(), [[0, 1]]):
        t = x[:, simplex[1:]] - x[:, simplex[:1]]
        d = points - x[:, None, simplex[0]]  # (facet, point, n)
        s = np.einsum("fpi,fis->fps", d, np.linalg.pinv(t))
        off = np.linalg.norm(d - np.einsum("fps,fsi->fpi", s, t), axis=2)
        found |= ((off < 1e-9) & (s > 0).all(axis=2) & (s.sum(axis=2) < 1)).any(axis=1)
    return x[found].mean(axis=1)


def bodies(found, spaces):
    """Numbers of the bodies that touch."""
    return [tuple(spaces.index(V) for V, _ in sides) for sides in found]


def facets_of(V, on):
    """The middles of the exterior facets that have a property."""
    x = vertices(V).mean(axis=1)
    return x[on(x)]


@pytest.mark.ranks
@pytest.mark.parametrize("cell", PLANE + SPACE)
def test_block_on_a_plate(cell):
    """In the middle of a facet, over several ones, on their edges, over the plate's corner."""
    axes = [0, 2] if cell in PLANE else [0, 1, 2]

    def block(n, low, high):
        return space(np.array(n)[axes], np.array(low)[axes], np.array(high)[axes], cell)

    plate = block((6, 4, 1), (0, 0, 0), (6, 4, 1))
    for low, high in (
        ((1.4, 2.7), (1.6, 2.8)),
        ((1.4, 1.4), (3.6, 2.5)),
        ((1, 1), (3, 2)),
        ((4.5, 3.5), (7, 5)),
    ):
        (sides,) = find_touching([plate, block((2, 3, 2), (*low, 1), (*high, 2))])
        ends = zip(low, np.minimum(high, (6, 4)), strict=True)
        grid = np.meshgrid(*(np.linspace(a, b, 40)[1:-1] + 1e-3 for a, b in ends), [1.0])
        points = np.stack([x.ravel() for x in grid], axis=1)[:, axes]
        for V, facets in sides:
            assert facets.dtype == np.int32
            np.testing.assert_array_equal(middles(V, facets), hit(V, points))


@pytest.mark.ranks(cell=["tetrahedron"])
@pytest.mark.parametrize("cell", ("quadrilateral", "tetrahedron"))
def test_forty_blocks(cell):
    """Meshed each in its own way; blocks with but an edge or a corner in common don't touch."""
    num = (8, 5) if cell in PLANE else (5, 4, 2)
    places = list(product(*map(range, num)))
    spaces = [
        space((1 + k % 3, 1 + k % 2, 2)[: len(num)], at, np.add(at, 1), cell)
        for k, at in enumerate(places)
    ]
    found = find_touching(spaces)
    x = np.array(places)
    expected = [
        (i, j)
        for i, j in product(range(len(x)), repeat=2)
        if i < j and np.abs(x[i] - x[j]).sum() == 1
    ]
    assert bodies(found, spaces) == expected
    for (i, j), sides in zip(expected, found, strict=True):
        axis = np.abs(x[i] - x[j]).argmax()
        at = max(x[i, axis], x[j, axis])
        for V, facets in sides:
            on = facets_of(V, lambda x, axis=axis, at=at: np.isclose(x[:, axis], at))
            np.testing.assert_array_equal(middles(V, facets), on)


@pytest.mark.ranks(cell=["triangle"], n=[(6, 50)])
@pytest.mark.parametrize("cell", PLANE + SPACE)
@pytest.mark.parametrize("n", ((6, 50), (6, 8), (8, 8), (9, 7), (50, 6), (12, 60)))
def test_bush_in_a_hole(n, cell):
    """Two polygons of a circle, however coarse; not the bush's ends, nor what is far."""
    spaces = [ring(n[0], 0.5, 1, cell), ring(n[1], 1, 3, cell)]
    (sides,) = find_touching(spaces)
    for V, facets in sides:
        flat = (lambda x: np.ones(len(x), dtype=bool)) if cell in PLANE else _on_the_side
        on = facets_of(V, lambda x, flat=flat: (abs(_radius(x) - 1) < 0.14) & flat(x))
        np.testing.assert_array_equal(middles(V, facets), on)
    loose = [ring(n[0], 0.3, 0.5, cell), spaces[1]]
    assert find_touching(loose) == []
    assert bodies(find_touching(loose, distance=0.6), loose) == [(0, 1)]


def _radius(x):
    return np.linalg.norm(x[:, :2], axis=1)


def _on_the_side(x):
    return (x[:, 2] > 1e-9) & (x[:, 2] < 1 - 1e-9)


@pytest.mark.parametrize("cell", PLANE)
@pytest.mark.parametrize("n", ((4, 37), (37, 4), (4, 5)))
def test_curved_facets(n, cell):
    """A quarter of a circle in an edge."""
    spaces = [ring(n[0], 0.5, 1, cell, 2), ring(n[1], 1, 3, cell, 2)]
    ((a, b),) = find_touching(spaces)
    assert [comm.allreduce(len(facets)) for _, facets in (a, b)] == list(n)


@pytest.mark.ranks(2, degree=[2])
@pytest.mark.parametrize("degree", (1, 2))
def test_nested_shells(degree):
    pytest.importorskip("gmsh")
    radii = (0.5, 0.8, 1.2, 2)
    options = {"octant": False, "degree": degree}
    spaces, tags = [], []
    for (inner, outer), h in zip(pairwise(radii), (0.2, 0.7, 0.25), strict=True):
        mesh, ft = meshes.spherical_shell(comm, h, inner, outer, **options)
        spaces.append(fem.functionspace(mesh, ("Lagrange", 1)))
        tags.append(ft)
    found = find_touching(spaces)
    assert bodies(found, spaces) == [(0, 1), (1, 2)]
    for (a, b), i in zip(found, (0, 1), strict=True):
        expected = (tags[i].find(meshes.OUTER), tags[i + 1].find(meshes.INNER))
        for (V, facets), on in zip((a, b), expected, strict=True):
            owned = on[on < V.mesh.topology.index_map(2).size_local]
            np.testing.assert_array_equal(facets, owned)


@pytest.mark.parametrize("steps", (1, 8))
@pytest.mark.parametrize("cell", ("quadrilateral", "hexahedron"))
def test_rounded_and_chamfered_edges(cell, steps):
    """What goes away from the plate isn't on it: a chamfer; of a fillet a facet at most."""
    axes = [0, 2] if cell in PLANE else [0, 1, 2]

    def mapping(x):
        x = x.copy()
        angle = np.maximum(x[:, 0] - 1, 0) * np.pi / 2  # from 0 to a quarter turn at x = 2
        low, beyond = x[:, -1] == 0, x[:, 0] > 1
        x[beyond, 0] = 1 + np.where(low, np.sin(angle), x[:, 0] - 1)[beyond] / 2
        x[low, -1] = (1 - np.cos(angle[low])) / 2
        return x

    def block(n, low, high, **options):
        return space(np.array(n)[axes], np.array(low)[axes], np.array(high)[axes], cell, **options)

    rounded = block((2 * steps, 3, 1), (0, 0, 0), (2, 1, 1), mapping=mapping)
    plate = block((90, 4, 1), (-1, -1, -1), (2, 3, 0))
    ((side0, side1),) = find_touching([rounded, plate])
    x, y = middles(*side0), middles(*side1)
    rows = 1 if cell in PLANE else 3
    assert np.isclose(x[:, -1], 0).sum() == steps * rows
    assert len(x) <= (steps + (steps > 1)) * rows
    first = np.sin(np.pi / 2 / steps) / 2 if steps > 1 else 0  # facet of the fillet
    assert y[:, 0].min() > 0 and y[:, 0].max() < 1 + first


@pytest.mark.parametrize("cell", ("triangle", "tetrahedron"))
def test_layer(cell):
    """A layer fifty times thinner than facets are long: what lies behind it doesn't touch."""
    dim = 2 if cell in PLANE else 3
    ends = [(0, 1), (1, 1.02), (1.02, 2)]
    spaces = [
        space((k + 1,) * (dim - 1) + (1,), (0,) * (dim - 1) + (a,), (1,) * (dim - 1) + (b,), cell)
        for k, (a, b) in enumerate(ends)
    ]
    assert bodies(find_touching(spaces), spaces) == [(0, 1), (1, 2)]


@pytest.mark.ranks
def test_parts_of_a_mesh():
    """Three bricks of one mesh, in no order, and a plate below."""
    square = np.array([(0, 0), (1, 0), (0, 1), (1, 1)], dtype=float)
    x = np.vstack([np.add(square, (start, 0)) for start in (2, 0, 1)])
    cells = np.arange(12).reshape(3, 4)
    element = basix.ufl.element("Lagrange", "quadrilateral", 1, shape=(2,))
    if comm.rank:
        x, cells = x[:0], cells[:0]
    bricks = dolfinx.mesh.create_mesh(comm, cells, e=element, x=x)
    spaces = [fem.functionspace(bricks, ("Lagrange", 1))]
    spaces.append(space((2, 1), (0, -1), (3, 0), "triangle"))
    found = find_touching(spaces)
    # The parts are numbered from left to right
    assert bodies(found, spaces) == [(0, 0), (0, 1), (0, 0), (0, 1), (0, 1)]
    assert [middles(*side)[0, 0] for sides in found for side in sides[:1]] == [1, 0.5, 2, 1.5, 2.5]
    assert [comm.allreduce(len(side[1])) for _, side in found] == [1, 1, 1, 2, 1]


def test_nothing_touches():
    blocks = [space((2, 2), at, np.add(at, 1), "triangle") for at in ((0, 0), (1, 1), (-1, 1.01))]
    assert find_touching(blocks) == find_touching(blocks[:1]) == find_touching([]) == []
    blocks = [space((1, 1, 1), at, np.add(at, 1), "hexahedron") for at in product((0, 1), repeat=3)]
    assert find_touching([blocks[i] for i in (0, 3, 5, 6)]) == []
    same = space((2, 2), (0, 0), (1, 1), "quadrilateral")  # in one place: normals agree
    assert find_touching([space((3, 3), (0, 0), (1, 1), "quadrilateral"), same]) == []


@pytest.mark.ranks(cell=["tetrahedron"], n=[16])
@pytest.mark.parametrize(("n", "m"), [(16, 12), (12, 24), (40, 12)])
@pytest.mark.parametrize("cell", SPACE)
def test_edge_only(cell, n, m):
    """A tube in a ring's hole, a step higher, shares a circle with the ring, not an area."""
    hole = ring(n, 0.4, 1.2, cell)
    pairs = find_touching([hole, ring(m, 0.1, 0.4, cell, height=1, turned=0.1 * (m != 24))])
    assert not pairs
    assert [left.explained for left in pairs.left_out] == ["edge"]
    # Beyond the chords' sag they touch; so do rings narrower than that, and narrow straight strips
    sag = 0.4 * (1 - np.cos(np.pi / min(n, m)))
    (pair,) = find_touching([hole, ring(m, 0.1, 0.4 + 2 * sag, cell, height=1, turned=0.1)])
    assert pair.explained == "flat"
    thin = [ring(m, 0.4 - sag / 2, 0.4, cell, height=z, turned=z / 10) for z in (0, 1)]
    assert len(find_touching(thin)) == 1
    low = space((4, 3, 1), (0, 0, 0), (2, 1, 1), cell)
    assert len(find_touching([low, space((3, 3, 1), (1.999, 0, 1), (4, 1, 2), cell)])) == 1


def test_distance():
    for gap in (0.2, -0.2):  # apart, or in each other
        spaces = [
            space((3, 2), (0, 0), (1, 1), "triangle"),
            space((2, 2), (0, 1 + gap), (1, 2), "quadrilateral"),
        ]
        assert find_touching(spaces) == find_touching(spaces, distance=0.19) == []
        ((a, b),) = find_touching(spaces, distance=0.21)
        assert [comm.allreduce(len(facets)) for _, facets in (a, b)] == [3, 2]


@pytest.mark.ranks(2)
def test_wrong_input():
    (V, _), (W, _) = two_blocks()
    for spaces, distance, error, message in (
        ([V, W], 0, ValueError, "distance must be a positive length, not 0"),
        ([V, W.mesh], None, ValueError, r"spaces\[1\] is a Mesh, not a function space"),
        ([V, W, V], None, InterfaceError, r"spaces\[0\] and spaces\[2\] are on one mesh"),
        ([V, fem.functionspace(W.mesh, ("DG", 1))], None, InterfaceError, r"spaces\[1\].*Lagrange"),
        (
            [V, space((1, 1, 1), (0, 0, 0), (1, 1, 1), "hexahedron")],
            None,
            InterfaceError,
            r"spaces\[1\] lies on a 3-dimensional mesh in 3 dimensions; bodies must be all 2D",
        ),
        (
            [V, space((1, 1), (0, 0), (1, 1), "triangle", c=MPI.COMM_SELF)],
            None,
            InterfaceError,
            "different communicators",
        ),
    ):
        if "communicators" in message and comm.size == 1:
            continue  # one rank's communicators are alike
        with raises(error, message):
            find_touching(spaces, distance)
    W.mesh.geometry.x[:1] = np.nan
    with raises(InterfaceError, r"spaces\[1\] has NaN or infinite coordinates"):
        find_touching([V, W])


@pytest.mark.parametrize("turn", (1, 0.5))
@pytest.mark.parametrize("cell", ("triangle", "tetrahedron"))
@pytest.mark.parametrize("seed", range(3))
def test_irregular_arcs(cell, turn, seed):
    """Rings and half rings whose edges are 1 : 4 long: all facets are found, at the ends too."""
    rng = np.random.default_rng(seed)
    spaces, counts = [], rng.integers(12, 40, 2)
    for n, inner, outer in zip(counts, (0.5, 1), (1, 3), strict=True):
        lengths = rng.uniform(1, 4, n)
        ends = 2 * np.pi * turn * np.append(0, np.cumsum(lengths)) / lengths.sum()

        def mapping(x, ends=ends, n=n):
            angle = ends[np.rint(x[:, 1:2] * n).astype(int)]
            return np.hstack((x[:, :1] * np.cos(angle), x[:, :1] * np.sin(angle), x[:, 2:]))

        dim = 2 if cell in PLANE else 3
        low, high = (inner, 0, 0)[:dim], (outer, 1, 1)[:dim]
        spaces.append(space((1, n, 2)[:dim], low, high, cell, mapping, periodic=turn == 1))
    (pair,) = find_touching(spaces)
    found = [comm.allreduce(len(facets)) for _, facets in pair]
    assert found == [n * (1 if cell in PLANE else 4) for n in counts]
    assert pair.explained == "curved"


def prism(sides, per_side, inner, outer, cell):
    """A ring whose boundaries are regular polygons, with a number of facets on each side."""

    def mapping(x):
        side, part = np.divmod(x[:, 1:2] * sides, 1)
        ends = 2 * np.pi * np.hstack((side, side + 1)) / sides
        cosine, sine = (
            f(ends[:, :1]) * (1 - part) + f(ends[:, 1:]) * part for f in (np.cos, np.sin)
        )
        return np.hstack((x[:, :1] * cosine, x[:, :1] * sine, x[:, 2:]))

    dim = 2 if cell in PLANE else 3
    low, high = ((r, end, end) for end, r in enumerate((inner, outer)))
    count = (1, sides * per_side, 2)[:dim]
    return space(count, low[:dim], high[:dim], cell, mapping, periodic=True)


CLEARANCES = [(c, n) for c in (0.2, 0.05, -0.05) for n in ((1, 1), (2, 2), (3, 3), (2, 3))]
# The overlap of a flat side in a hollow one whose facets, one a side, may be chords of a circle is
# explained by these
CLEARANCES += [(0.2, (3, 1)), (0.05, (3, 1))]


@pytest.mark.parametrize(("clearance", "per_side"), CLEARANCES)
@pytest.mark.parametrize(("sides", "cell"), [*zip((6, 12, 6, 8), PLANE + SPACE, strict=True)])
def test_clearance_of_flat_sides(clearance, cell, sides, per_side):
    """Corners of less than 65° aren't curvature, nor are flat sides that keep their distance."""
    h = 2 * np.sin(np.pi / sides) / max(per_side)
    off = 1 + clearance * h
    a, b = (prism(sides, n, *r, cell) for n, r in zip(per_side, ((0.5, 1), (off, 3)), strict=True))
    assert find_touching([a, b]) == []
    (pair,) = find_touching([a, b], distance=1.01 * abs(clearance) * h)
    apart = clearance * h * np.cos(np.pi / sides)
    np.testing.assert_allclose(pair.apart, apart)
    assert pair.explained in ("curved", "distance")
    side0, side1 = pair
    for (V, facets), n, r in ((side0, per_side[0], 1), (side1, per_side[1], off)):
        near = np.cos(np.pi / sides) * r - 1e-9
        rim = facets_of(V, lambda x, near=near, r=r: (_radius(x) > near) & (_radius(x) < r + 1e-9))
        if cell in SPACE:
            rim = rim[_on_the_side(rim)]
        np.testing.assert_array_equal(middles(V, facets), rim)


@pytest.mark.parametrize("cell", ("triangle", "hexahedron"))
@pytest.mark.parametrize("n", ((12, 12), (12, 17), (24, 7), (7, 24), (30, 41), (8, 9)))
def test_clearance_of_curved_sides(n, cell):
    """Polygons of circles a clearance or an overlap apart: none touches another one across 1.5
    times the larger sag, nor at all where nodes meet; what is left out of a pair is told."""
    sag = 1 - np.cos(np.pi / min(n))
    bush = ring(n[0], 0.5, 1, cell)
    for clearance in (0.1, -0.1, 0.5, -0.5, 1, -1, 1.5, -1.5, 2):
        found = find_touching([bush, ring(n[1], 1 + clearance * sag, 3, cell)])
        if abs(clearance) >= 1.5 or n[0] == n[1]:
            kinds = {left.explained for left in found.left_out}
            assert not found and kinds <= {"overlap" if clearance < 0 else "clearance"}
        for pair in found:
            rim = tuple(count * (1 if cell in PLANE else 2) for count in n)
            told = pair.left_out is not None and pair.left_out.explained == "unexplained"
            assert told or pair.counts == rim


@pytest.mark.ranks(2, cell=["triangle"])
@pytest.mark.parametrize("cell", PLANE + SPACE)
@pytest.mark.parametrize("n", ((2, 4), (2, 2), (3, 2), (7, 2), (5, 3)))
def test_inflection(n, cell):
    """A face of few facets that bends to and fro: turns between them vanish, not distances."""
    axes = [0, 2] if cell in PLANE else [0, 1, 2]

    def mapping(x):
        x = x.copy()
        x[:, -1] += 0.1 * np.sin(2.5 * x[:, 0] - 1.25)
        return x

    spaces = [
        space(
            np.array((num, 3, 2))[axes],
            np.array((0, 0, k))[axes],
            np.array((1, 1, k + 1))[axes],
            cell,
            lambda x, k=k: mapping(
                x + (0.2 - 0.4 * k) * x * (1 - x) * (np.arange(x.shape[1]) == 0)
            ),
        )
        for k, num in enumerate(n)
    ]
    (pair,) = found = find_touching(spaces)
    rows = {"triangle": 1, "quadrilateral": 1, "tetrahedron": 6, "hexahedron": 3}[cell]
    if pair.left_out:  # one facet at an end
        assert n in ((2, 4), (7, 2)) and pair.left_out.explained == "unexplained"
    else:
        assert pair.counts == tuple(num * rows for num in n) and found.left_out == []


@pytest.mark.ranks(2)
def test_table(caplog):
    """What touches, what faces something across a clearance, and what was left out."""
    spaces = [
        space((3, 2), (0, 0), (1, 1), "triangle"),
        space((2, 2), (0, 1), (1, 1.03), "quadrilateral"),
        space((2, 2), (0, 1.03), (1, 2), "triangle"),
    ]
    spaces[1].mesh.name = "layer"
    found = find_touching(spaces)
    assert [pair.numbers for pair in found] == [(0, 1), (1, 2)]
    assert [pair.counts for pair in found] == [(3, 2), (2, 2)]
    assert [pair.left_out for pair in found] == [None, None]
    np.testing.assert_allclose([pair.area for pair in found], 1)
    (left,) = found.left_out
    assert left.numbers == (0, 2) and left.counts == (3, 2) and left.explained == "clearance"
    np.testing.assert_allclose(left.apart, 0.03)
    rows = str(found).splitlines()
    assert len(rows) == 5 and rows[3] == "left out:"
    assert "spaces[0]: 3 facets" in rows[1] and "spaces[1] (layer): 2 facets" in rows[1]
    assert rows[1].endswith("flat") and rows[4].endswith("clearance")
    assert str(find_touching(spaces[:1])).splitlines()[1] == "nothing touches"
    assert not caplog.records
    with caplog.at_level("INFO", logger="hypergap_dolfinx"):
        find_touching(spaces)
    told = "spaces[0] and spaces[1] (layer) touch with 3 and 2 facets, up to 0 apart (flat)"
    assert [record.getMessage() for record in caplog.records][:1] == [told][comm.rank :]
    caplog.clear()
    bush = [ring(n, *radii, "triangle") for n, radii in ((12, (0.5, 1)), (17, (1.01, 3)))]
    (pair,) = found = find_touching(bush)
    assert found.left_out == [pair.left_out] and pair.left_out.explained == "unexplained"
    messages = [record.getMessage() for record in caplog.records]
    assert len(messages) == (comm.rank == 0)
    for message in messages:
        assert message.startswith(
            "find_touching leaves out 4 facets of spaces[0] and 4 of spaces[1]"
        )


@pytest.mark.ranks(2, overlap=[0.1], above=[1])
@pytest.mark.parametrize("above", (0.04, 1))
@pytest.mark.parametrize("overlap", (0.01, 0.1, 0.3))
def test_bodies_that_overlap(overlap, above, caplog):
    """By less than a facet: they are told to, but thin layers that touch or are apart aren't."""
    if overlap > above:
        return
    low = space((3, 2), (0, 0), (1, 1), "triangle")
    high = space((2, 2), (0, 1 - overlap), (1, 1 + above - overlap), "quadrilateral")
    found = find_touching([low, high])
    assert not found and find_touching([low, high], distance=1.01 * overlap)
    (left,) = found.left_out
    assert left.explained == "overlap" and left.counts == (3, 2)
    np.testing.assert_allclose((left.apart, left.area), (-overlap, 1))
    told = [record.getMessage() for record in caplog.records]
    said = f"spaces[0] and spaces[1] overlap by up to {overlap:.3g}"
    assert len(told) == (comm.rank == 0) and all(one.startswith(said) for one in told)
    layers = [
        space((3, 1), (0, start), (1, start + 0.01), "triangle") for start in (0, 0.01, 0.05, 0.06)
    ]
    caplog.clear()
    found = find_touching(layers)
    assert len(found) == 2 and all(left.explained == "clearance" for left in found.left_out)
    assert not caplog.records


@pytest.mark.ranks(2, cell=["quadrilateral"], n=[2])
@pytest.mark.parametrize("distance", (None, 0.02, 0.2))
@pytest.mark.parametrize("n", (1, 2, 5))
@pytest.mark.parametrize("cell", PLANE + SPACE)
def test_sheared_blocks(cell, n, distance):
    """Four blocks with corners of 60° and 120°, one cell or several: those that meet in a corner,
    and sides around the corner, don't touch."""

    def sheared(x):
        x = x.copy()
        x[:, 0] += np.tan(np.pi / 6) * x[:, 1]
        return x

    dim = 2 if cell in PLANE else 3
    places = list(product((0, 1), repeat=2))
    spaces = [
        space((n + k,) * dim, (*at, 0)[:dim], (*np.add(at, 1), 1)[:dim], cell, sheared)
        for k, at in enumerate(places)
    ]
    found = find_touching(spaces, distance)
    assert bodies(found, spaces) == [(0, 1), (0, 2), (1, 3), (2, 3)]
    for pair in found:
        assert pair.explained == "flat" and abs(pair.apart) < 1e-14
        i, j = (spaces.index(V) for V, _ in pair)
        axis = np.abs(np.subtract(places[i], places[j])).argmax()
        for V, facets in pair:

            def on(x, axis=axis):
                return np.isclose((x[:, 0] - np.tan(np.pi / 6) * x[:, 1], x[:, 1])[axis], 1)

            np.testing.assert_array_equal(middles(V, facets), facets_of(V, on))
