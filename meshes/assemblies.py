# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Eight assemblies as machines have them, built with Gmsh's OpenCASCADE kernel.

Each function takes ``gmsh.model.occ``, adds volumes that touch, and returns them by name. The first
one is held where x is least, the last one is loaded. For :mod:`meshes.cad`.
"""

import math

Volume = tuple[int, int]
Parts = dict[str, Volume]


def _box(cad, low, high) -> Volume:
    return 3, cad.addBox(*low, *(b - a for a, b in zip(low, high, strict=True)))


def _rod(cad, start, along, r) -> Volume:
    return 3, cad.addCylinder(*start, *along, r)


def _cut(cad, volume: Volume, *tools: Volume) -> Volume:
    """A volume without others, which stay."""
    return _hollow(cad, volume, *cad.copy(list(tools)))  # else they would share faces


def _hollow(cad, volume: Volume, *tools: Volume) -> Volume:
    """A volume without others, which go."""
    (result,), _ = cad.cut([volume], list(tools))
    return result


def _joined(cad, *volumes: Volume) -> Volume:
    (result,), _ = cad.fuse(volumes[:1], list(volumes[1:]))
    return result


def _prism(cad, corners, depth) -> Volume:
    """A polygon in x and z, extruded along y."""
    points = [cad.addPoint(x, 0, z) for x, z in corners]
    lines = [cad.addLine(points[k - 1], points[k]) for k in range(len(points))]
    face = cad.addPlaneSurface([cad.addCurveLoop(lines)])
    solids = [volume for volume in cad.extrude([(2, face)], 0, depth, 0) if volume[0] == 3]
    return solids[0]


def flange(cad) -> Parts:
    """Two flanged pipes, a gasket between them, and four bolts with heads and nuts."""
    r = 0.2
    places = [(1.4 * math.cos(a), 1.4 * math.sin(a)) for a in (0.5, 2.1, 3.6, 5.3)]

    def disc(x, width, outer, inner=0.8):
        ring = _rod(cad, (x, 0, 0), (width, 0, 0), outer)
        return _hollow(cad, ring, _rod(cad, (x, 0, 0), (width, 0, 0), inner))

    def holes(x, width):
        return [_rod(cad, (x, y, z), (width, 0, 0), r) for y, z in places]

    left = _joined(cad, disc(-1.6, 1.6, 1.0), disc(-0.4, 0.4, 1.9))
    right = _joined(cad, disc(0.15, 1.6, 1.0), disc(0.15, 0.4, 1.9))
    left = _hollow(cad, left, *holes(-1, 2))
    right = _hollow(cad, right, *holes(-1, 2))
    parts = {"left pipe": left, "gasket": disc(0, 0.15, 1.15)}
    for k, (y, z) in enumerate(places):
        head = _rod(cad, (-0.6, y, z), (0.2, 0, 0), 0.35)
        nut = _rod(cad, (0.55, y, z), (0.2, 0, 0), 0.35)
        shank = _rod(cad, (-0.6, y, z), (1.35, 0, 0), r)
        parts[f"bolt {k + 1}"] = _joined(cad, shank, head, nut)
    return parts | {"right pipe": right}


def shaft(cad) -> Parts:
    """A hub on a shaft, with a key in both."""
    whole = _rod(cad, (-1.5, 0, 0), (3, 0, 0), 0.5)
    key = _box(cad, (-0.5, -0.15, 0.3), (0.5, 0.15, 0.7))
    hub = _rod(cad, (-0.6, 0, 0), (1.2, 0, 0), 1.1)
    hub = _hollow(cad, hub, _rod(cad, (-0.6, 0, 0), (1.2, 0, 0), 0.5))
    return {"shaft": _cut(cad, whole, key), "key": key, "hub": _cut(cad, hub, key)}


def sandwich(cad) -> Parts:
    """A soft core between two face plates, with an insert through all of it."""
    insert = _rod(cad, (0.4, 0.1, -0.1), (0, 0, 1.2), 0.35)
    insert = _joined(cad, insert, _rod(cad, (0.4, 0.1, 1), (0, 0, 0.15), 0.6))
    parts = {"core": _box(cad, (-1.7, -1, 0.15), (1.5, 1, 0.85))}
    parts["lower plate"] = _box(cad, (-1.5, -1, 0), (1.5, 1, 0.15))
    parts["upper plate"] = _box(cad, (-1.5, -1, 0.85), (1.5, 1, 1))
    return {name: _cut(cad, part, insert) for name, part in parts.items()} | {"insert": insert}


def pipe_through_wall(cad) -> Parts:
    """A pipe that stands out of a wall on both sides."""
    start, along = (0, -0.8, 0), (0, 2.2, 0)
    outer = _rod(cad, start, along, 0.5)
    wall = _cut(cad, _box(cad, (-1.2, -0.3, -1), (1, 0.3, 1)), outer)
    return {"wall": wall, "pipe": _hollow(cad, outer, _rod(cad, start, along, 0.35))}


def hinge(cad) -> Parts:
    """Two leaves with knuckles around a pin."""

    def leaf(x, bands):
        plate = _box(cad, (min(0.3 * x, 2 * x), -1.2, -0.15), (max(0.3 * x, 2 * x), 1.2, 0.15))
        knuckles = []
        for low, high in bands:
            bridge = _box(cad, (min(0, x), low, -0.15), (max(0, x), high, 0.15))
            knuckles += [bridge, _rod(cad, (0, low, 0), (0, high - low, 0), 0.45)]
        return _joined(cad, plate, *knuckles)

    def clear(part, bands):
        """Room for the other leaf's knuckles, wider than these."""
        rooms = [_rod(cad, (0, a - 0.02, 0), (0, b - a + 0.04, 0), 0.55) for a, b in bands]
        return _hollow(cad, part, *rooms, _rod(cad, (0, -1.2, 0), (0, 2.4, 0), 0.2))

    ends, middle = ((-1.2, -0.42), (0.42, 1.2)), ((-0.38, 0.38),)
    pin = _rod(cad, (0, -1.3, 0), (0, 2.6, 0), 0.2)
    return {
        "left leaf": clear(leaf(-1, ends), middle),
        "pin": pin,
        "right leaf": clear(leaf(1, middle), ends),
    }


def dovetail(cad) -> Parts:
    """A tail that is slid into a socket along y."""
    tail = [(-0.4, 0.5), (-0.6, 0), (0.6, 0), (0.4, 0.5), (1, 0.5), (1, 1.1), (-1, 1.1), (-1, 0.5)]
    tail = _prism(cad, tail, 1.4)
    socket = _cut(cad, _box(cad, (-1.3, 0, -0.6), (1.3, 1.4, 0.5)), tail)
    return {"socket": socket, "tail": tail}


def tubes(cad) -> Parts:
    """Three tubes in each other, each longer than the one around it."""
    parts = {}
    for k, (r, x) in enumerate(((0.9, -1.0), (0.7, -0.6), (0.5, -0.2))):
        tube = _rod(cad, (x, 0, 0), (2, 0, 0), r)
        parts[f"tube {k + 1}"] = _hollow(cad, tube, _rod(cad, (x, 0, 0), (2, 0, 0), r - 0.2))
    return parts


def ball_in_socket(cad) -> Parts:
    """A ball with a stem, held by a socket that is open at the top."""
    ball = 3, cad.addSphere(0, 0, 0, 0.7)
    block = _box(cad, (-1.1, -1, -1.1), (1.1, 1.2, 0.3))
    socket = _hollow(cad, block, (3, cad.addSphere(0, 0, 0, 0.7)))
    stem = _rod(cad, (0, 0, 0), (0, 0, 1.6), 0.25)
    return {"socket": socket, "ball": _joined(cad, ball, stem)}


ASSEMBLIES = {
    build.__name__.replace("_", " "): build
    for build in (
        flange,
        shaft,
        sandwich,
        pipe_through_wall,
        hinge,
        dovetail,
        tubes,
        ball_in_socket,
    )
}
"""All, by name."""
