# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The compiled C: arrays that are handed over, files, libraries."""

import os
import subprocess
import sysconfig

import numpy as np
import pytest
from helpers import raises, skew, two_blocks

from hypergap_dolfinx import Tie
from hypergap_dolfinx.contact_geometry.plane import PlaneSegments
from hypergap_dolfinx.core import compiled
from hypergap_dolfinx.core.compiled import call, dtype, ints, struct
from hypergap_dolfinx.surface.moving import MovingSurface
from hypergap_dolfinx.surface.trace import create_surface

POINTS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0.0)])
TRIANGLES = ints([(0, 1, 2)])
FILES = sorted(compiled.FOLDER.glob("*.c"))


def nearest(points=POINTS, node=None, edge=None, s=None, n=3):
    """Each point's nearest of the points."""
    node = np.empty(3, dtype=np.int32) if node is None else node
    call("find_nearest", n, points, 3, POINTS, node, edge, s)
    return node


def frozen(array):
    array.flags.writeable = False
    return array


def test_call():
    """Arrays to read may be read-only, None is NULL."""
    np.testing.assert_array_equal(nearest(frozen(POINTS.copy())), np.arange(3))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"points": POINTS.astype(np.float32)}, "points is of float32; it must be of float64"),
        ({"points": np.asfortranarray(POINTS)}, "points isn't C-contiguous"),
        ({"points": POINTS.tolist()}, "points is of .*list.*; it must be an array of float64"),
        ({"node": np.empty(3, dtype=np.int64)}, "node is of int64; it must be of int32"),
        ({"node": np.empty(6, dtype=np.int32)[::2]}, "node isn't C-contiguous"),
        ({"node": frozen(np.empty(3, dtype=np.int32))}, "node isn't writeable"),
        ({"n": np.array([3])}, "num is an array; it must be int"),
    ],
)
def test_refused(given, message):
    """No array is reinterpreted, converted or copied: messages name the argument."""
    with raises(TypeError, f"find_nearest's {message}"):
        nearest(**given)


def test_refused_structs():
    with raises(TypeError, "takes 8 arguments, not 1"):
        call("project", 1)
    given = (3, POINTS, POINTS, TRIANGLES, TRIANGLES)
    with raises(TypeError, r"project's curves is of .*; it must be Curves \*"):
        call("project", *given, struct("Rays"), TRIANGLES.copy(), np.empty((3, 2)))
    with raises(TypeError, "points is of .*; it must be an array of float64"):
        nearest(struct("Curves"))
    with raises(TypeError, "Curves's powers is of int64; it must be of int32"):
        struct("Curves", powers=np.zeros((1, 2), dtype=np.int64))
    with raises(TypeError, "Facets's x isn't C-contiguous"):
        compiled.structs("Facets", [{"x": POINTS}, {"x": POINTS.T}])
    sheets = np.empty(1, dtype=[("edge", np.int32)])
    with raises(TypeError, "Sigma's sheets is of .*edge.*; it must be of .*beside"):
        struct("Sigma", sheets=sheets)


def test_structs_keep_arrays():
    """What a struct points to lives as long as the struct does."""
    sheets = np.full(1000, 7, dtype("Sheet"))
    sigma = struct("Sigma", sheets=sheets, rule_at=np.full(1000, 5.0))
    del sheets
    others = [np.zeros(1000, dtype("Sheet")) for _ in range(10)]
    assert sigma.sheets[999].edge == 7 and sigma.rule_at[999] == 5
    assert not any(other["edge"].any() for other in others)


def test_copy_of_struct():
    """A copy has its own values where they are changed, also in structs in it, and keeps others."""
    nodes = [np.full((2, 2), 3.0 + k) for k in range(2)]
    first = struct("Sigma", sides=[{"num_edges": 5}, {"num_edges": 6}], rule_at=np.full(1000, 5.0))
    second = compiled.changed(first, "Sigma", sides=[{"nodes": x} for x in nodes], slack=2.0)
    assert first.slack == 0 and not first.sides[0].nodes
    del first, nodes
    others = [np.zeros(1000) for _ in range(10)]
    assert second.slack == 2 and [side.num_edges for side in second.sides] == [5, 6]
    assert [side.nodes[3] for side in second.sides] == [3, 4] and second.rule_at[999] == 5
    assert not any(other.any() for other in others)
    with raises(TypeError, "Side's nodes is of int64; it must be of float64"):
        compiled.changed(second, "Sigma", sides=[{"nodes": np.zeros((1, 2), np.int64)}] * 2)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_file_alone(file):
    """Each file compiles without another one, without a warning."""
    compiler = os.environ.get("CC", sysconfig.get_config_var("CC") or "cc").split()
    command = [*compiler, "-std=c11", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", str(file)]
    try:
        run = subprocess.run(command, capture_output=True, text=True)
    except FileNotFoundError:
        pytest.skip("no C compiler")
    assert run.returncode == 0, run.stderr


def test_each_file_in_one_library():
    names = [name for library in compiled.SOURCES.values() for name in library]
    assert sorted(names) == [file.stem for file in FILES]


def test_plane_alone(monkeypatch):
    """Ties and contact in the plane don't wait for the C of space to be compiled."""
    load, loaded = compiled.library, set()

    def library(name):
        assert name in ("plane", "sparse")
        loaded.add(name)
        return load(name)

    monkeypatch.setattr(compiled, "library", library)
    blocks = two_blocks(mapping=skew)
    Tie(*blocks)
    sides = tuple(MovingSurface(create_surface(*block, "Γ")) for block in blocks)
    u = tuple(np.zeros((len(side.dofs), 2)) for side in sides)
    segments = PlaneSegments.between(sides, u, [np.zeros(part.shape, dtype=bool) for part in u])
    assert np.isfinite(segments.gap(u)[0]).all() and loaded
