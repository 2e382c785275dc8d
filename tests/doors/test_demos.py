# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Every demo runs as a script, on any number of ranks, and gives its numbers and pictures."""

import json
import runpy
import sys
from dataclasses import dataclass, field
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from helpers import sweep, thorough

from dolfinx import default_scalar_type

comm = MPI.COMM_WORLD
FOLDER = Path(__file__).parents[2] / "demos"


@dataclass
class Demo:
    """How a demo is run and what it then says."""

    arguments: str = ""
    pinned: dict[str, float] = field(default_factory=dict)
    """Results, ``"row.name"`` of the JSON file, known to ``accuracy``."""
    below: dict[str, float] = field(default_factory=dict)
    """Results that are round-off, and their bounds."""
    accuracy: float = 1e-3
    pictures: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    slow: bool = False
    status: int = 0
    """Exit status."""
    script: str = ""
    """Its file, if not by its name."""
    complex_numbers: bool = False
    """Whether it needs complex scalars; then it runs with `make test-complex`."""


def some(all_of, others):
    """Numbers of random scenes: all that a heuristic or threshold needs, every third one else."""
    return " ".join(["--only", *all_of.split(), *sweep(others.split(), 3)])


DEMOS = {
    "any_assemblies": Demo(some("", "2 4 8 9 10 11 16 17"), {"*.ok": True}),
    "any_assemblies_in_space": Demo(
        "--dim 3 " + some("32", "11 2 18 14 23 3 19 25"), {"*.ok": True}, script="any_assemblies"
    ),
    "any_assemblies_conforming": Demo(
        "--only 2 --conforming 0",
        {"*.ok": True},
        {"*.conforming": 1.1},
        needs=("gmsh",),
        script="any_assemblies",
    ),
    "any_assemblies_all": Demo(
        "--scenes 60", {"*.solved": True}, slow=True, script="any_assemblies"
    ),
    "any_assemblies_in_space_all": Demo(
        "--dim 3 --scenes 60", {"*.solved": True}, slow=True, script="any_assemblies"
    ),
    "any_contacts": Demo(
        some(
            "354 699 852 963 1030 1750",
            "1 2 3 4 7 10 11 12 15 18 24 36 105 127 132 136 147 163 182 198 208 212 252 292 379 "
            "452 21 98 155 231",
        ),
        {"*.ok": True},
        needs=("gmsh", "scipy"),
    ),
    "any_contacts_in_space": Demo(
        "--dim 3 " + some("", "5 13 27 26"),
        {"*.ok": True},
        needs=("gmsh", "scipy"),
        script="any_contacts",
    ),
    "bearing": Demo(
        "--cells 36 --steps 3",
        {"torque.1.rotation": 2.84e-3, "rotation.3.torque": 2.8754e-2},
        {"rolling_error": 0.02, "friction_error": 1e-2, "newton.*": 15},
        accuracy=1e-2,
        pictures=("bearing",),
        needs=("matplotlib",),
        slow=True,  # test_rigid_body
    ),
    "benchmarks": Demo("--scene plate wedge", {"rows.*.met": True}),
    "benchmarks_all": Demo("", {"rows.*.met": True}, slow=True, script="benchmarks"),
    "any_surfaces": Demo("--scenes 30 --seed 2000 --finest 0.4", {"*.valid": 1}, needs=("scipy",)),
    "any_surfaces_all": Demo(
        "--scenes 200 --seed 2000 --finest 0.4",
        {"*.valid": 1},
        needs=("scipy",),
        slow=True,
        script="any_surfaces",
    ),
    "assembly": Demo(
        pinned={"*.displacement": 3.39994e-2, "*.energy": 18.3092, "*.ties": 32},
        below={"*.balance": 1e-10},
        pictures=("assembly", "deformed"),
        needs=("gmsh",),
        slow=True,
    ),
    "error_against_run_time": Demo(
        "--scene cylinder --degrees 2 --levels 2 --repeats 1",
        {"rows.0.l2": 3.359e-6, "rows.2.l2": 4.201e-7, "rows.3.stress": 1.738e-4},
        {"rows.*.residual": 1e-10},
        pictures=("cylinder",),
        needs=("matplotlib",),
    ),
    "bolted_assembly": Demo(
        "--steps 1",
        {"rows.0.over_estimate": 0.93, "rows.1.zones.foot.parted": 0.75},
        {"rows.*.newton": 15, "rows.*.halvings": 0, "rows.*.balance": 1e-9},
        accuracy=0.1,  # as far as versions of Gmsh agree
        pictures=("bolted_assembly",),
        needs=("gmsh", "matplotlib"),
        slow=True,
    ),
    "cad_assemblies": Demo("--only shaft --degree 1", {}, {"*.ratio": 1.2}, needs=("gmsh",)),
    "cad_dovetail": Demo(
        "--only dovetail --degree 2" + " 1" * thorough,
        {},
        {"*.ratio": 1.2},
        needs=("gmsh",),
        script="cad_assemblies",
    ),
    "cad_sandwich": Demo(
        "--only sandwich --degree 2 --imprinted",
        {},
        {"*.ratio": 1.5},
        needs=("gmsh",),
        slow=True,
        script="cad_assemblies",
    ),
    "contact_run_time": Demo(
        "--scene contact --dims 2 --degrees 1 --levels 1 --repeats 1",
        {
            "contact.0.l2_pressure": 1.505e-2,
            "contact.1.l2_pressure": 1.500e-2,
            "contact.0.steps": 1,
            "contact.1.steps": 2,
        },
        {"contact.*.p0": 2.6e-3, "contact.*.force": 5e-4},
        accuracy=2e-3,
        pictures=("contact",),
        needs=("matplotlib",),
        script="error_against_run_time",
        slow=True,
    ),
    "bouncing": Demo(
        "--height 0.1 --time 1.4 --step 0.02",
        {"bounces.*.leaves": 1.28, "bounces.*.drift": 2.31e-4},
        {"rows.*.iterations": 5, "bounces.*.gained": 3e-4},
        accuracy=1e-2,
        pictures=("bouncing",),
        needs=("matplotlib",),
    ),
    "contact_patch": Demo(
        "--quick",
        below={"rows.*.pressure": 1e-11, "rows.*.stress": 1e-11},
        pictures=("contact_patch",),
    ),
    "friction": Demo(
        "--scene wedge --scene cattaneo --cells 6",
        {"rows.1.l2_shear": 0.15444, "rows.1.q_over_mu_p": 0.32665},
        {"rows.0.error": 1e-5, "rows.1.off": 1.0, "rows.1.l2_surface": 0.06},
        pictures=("friction",),
        needs=("matplotlib",),
    ),
    "friction_exact": Demo(
        "--scene block --scene twist --scene sphere --scene roll",
        {"rows.0.told": 1, "rows.1.told": 1, "rows.2.told": 1, "rows.3.told": 1}
        | {"rows.5.slid": 1},
        {"rows.0.error": 1e-11, "rows.1.error": 1e-11, "rows.2.error": 1e-11}
        | {"rows.3.error": 1e-11, "rows.4.error": 1e-2, "rows.5.off": 1.0, "rows.5.steps.*": 10}
        | {"rows.6.q_over_mu_p": 0.01, "rows.6.slips": 1e-3, "rows.6.steps.*": 10},
        slow=True,
        script="friction",
    ),
    "gap_domain": Demo(
        pinned={"triangles": 12, "tetrahedra.0": 18, "tetrahedra.2": 32},
        pictures=("apart", "gap_domain", "tetrahedra"),
        needs=("pyvista", "matplotlib"),
    ),
    "heat": Demo(
        "--n 4 --steps 10",
        {"steady": 5.960e-4, "flux": 1.3023e-2, "transient": 1.1088e-3},
        pictures=("heat",),
    ),
    "hertz": Demo(
        "--levels 1",
        {"rows.0.l2_pressure": 2.1656e-2, "rows.0.steps": 2},
        {"rows.0.force": 1e-8, "rows.0.p0": 1e-3, "rows.0.half_width": 0.1001},
        pictures=("hertz",),
        needs=("matplotlib",),
    ),
    "hertz_published": Demo(
        "--published disc-on-block spheres",
        {"rows.0.exact_p0": 6.6124},
        {"rows.*.p0": 5e-3, "rows.*.half_width": 1e-2},
        script="hertz",
    ),
    "hertz_published_all": Demo(
        "--published",
        below={"rows.*.p0": 1e-2, "rows.*.half_width": 1e-2, "rows.0.approach": 1e-2},
        slow=True,
        script="hertz",
    ),
    "hertz_solids": Demo(
        "--dim 3 --levels 1",
        {"rows.0.l2_pressure": 6.71e-2},
        {"rows.0.force": 1e-8, "rows.0.p0": 2e-2, "rows.0.half_width": 0.1},
        accuracy=0.1,  # as far as versions of Gmsh agree
        needs=("gmsh",),
        slow=True,
        script="hertz",
    ),
    "hertz_solids_degree_2": Demo(
        "--dim 3 --degree 2 --ratio 1 --levels 2",
        {"rows.1.l2_pressure": 3.09e-2},
        {"rows.*.force": 1e-8, "rows.*.p0": 1e-2, "rows.*.steps": 12.1},
        accuracy=0.1,
        needs=("gmsh",),
        slow=True,
        script="hertz",
    ),
    "hyperelasticity": Demo(
        "--steps 6",
        {"energy": 0.26857578, "energy_difference": 6.255e-4, "newton_steps.-1": 6},
        {"residuals.-1": 1e-11, "residuals.-2": 1e-6, "displacement_difference": 1e-5},
        pictures=("hyperelasticity",),
    ),
    "incompressible": Demo(
        "--levels 2",
        {"0.error": 2.8192e-4, "1.error": 3.536e-5, "1.stress": 1.571e-3, "1.pressure": 7.530e-4},
        {"2.error": 1e-11},
        pictures=("incompressible",),
    ),
    "ironing": Demo(
        "--flat --steps 4",
        {"rows.7.fy": -0.29572, "rows.7.halvings": 0},
        {"rows.*.energy_error": 1e-6},
        pictures=("ironing",),
        needs=("matplotlib",),
    ),
    "ironing_snaps": Demo(
        "--flat --swap --friction 0.5 --steps 8",
        {"rows.11.along_surfaces": 0.5},
        {"rows.*.iterations": 8, "rows.*.halvings": 0},
        accuracy=1e-9,
        script="ironing",
    ),
    "ironing_far": Demo(
        "--friction 0.5 --step 5 --steps 1 --back 1",
        {"rows.4.along_surfaces": 0.5},
        {"rows.*.iterations": 6, "rows.*.halvings": 0},
        accuracy=1e-9,
        script="ironing",
    ),
    "ironing_quadratic": Demo(
        "--flat --degree 2 --friction 0.2 --steps 8",
        {"rows.11.fy": -0.29369},
        {"rows.*.halvings": 0, "rows.*.iterations": 16},
        slow=True,
        script="ironing",
    ),
    "ironing_sticking": Demo(
        "--flat --degree 2 --friction 0.5 --steps 4",
        below={"rows.*.halvings": 0, "rows.*.iterations": 10},
        slow=True,
        script="ironing",
    ),
    "ironing_solids": Demo(
        "--dim 3 --steps 6",
        {"rows.9.fy": -0.122},
        {"rows.*.energy_error": 1e-6},
        accuracy=1e-2,
        slow=True,
        script="ironing",
    ),
    "kernel_speed": Demo("--quick"),
    "large_contact": Demo(
        "--levels 1 --scene ball",
        below={"rows.*.newton_most": 12, "rows.*.iterations_most": 35, "rows.*.halvings": 0},
    ),
    "large_contact_refined": Demo(
        "--levels 3",
        below={"rows.*.newton_most": 12, "rows.*.iterations_most": 60, "rows.*.halvings": 0},
        slow=True,
        script="large_contact",
    ),
    "modal_analysis": Demo(
        "--modes 4",
        {"frequencies.0": 0.2890020, "frequencies.3": 1.0574755},
        {"error_tied": 1.3e-3},
        accuracy=1e-6,
        pictures=("mode_1", "mode_4"),
        needs=("slepc4py",),
    ),
    "own_system": Demo("--levels 2", {"0.l2": 5.402e-5, "1.l2": 6.759e-6}, {"1.iterations": 180}),
    "partial_overlap": Demo(
        "--degree 1 --cell mixed --scene rotated crossing",
        {"*.ok": True},
    ),
    "partial_overlap_mixed": Demo(
        "--degree 1 --cell mixed",
        {"*.ok": True},
        {"*.l2": 5e-3},
        script="partial_overlap",
        slow=True,
    ),
    "partial_overlap_tetrahedra": Demo(
        "--cell tetrahedron",
        {"*.ok": True},
        pictures=("gap_domain", "block_on_a_plate", "bush_in_a_bracket"),
        script="partial_overlap",
        slow=True,
    ),
    "partial_overlap_hexahedra": Demo(
        "--cell hexahedron --degree 1", {"*.ok": True}, script="partial_overlap", slow=True
    ),
    "patch_test": Demo(
        below={"*.l2": 1e-12, "*.stress": 1e-12}, pictures=("patch_test",), slow=True
    ),
    "patch_test_3d": Demo(
        below={"*.l2": 1e-11, "*.stress": 1e-11},
        pictures=("patch_test_3d",),
        needs=("gmsh",),
        slow=True,
    ),
    "patch_test_3d_hexahedra": Demo(
        "--cell hexahedron",
        below={"*.l2": 1e-11, "*.stress": 1e-11},
        script="patch_test_3d",
        slow=True,
    ),
    "pressurised_cylinder": Demo(
        "--degree 2 --levels 2",
        {"1.l2": 3.240e-5, "1.stress": 2.866e-3, "1.traction": 7.757e-4},
        pictures=("gap_domain", "deformed", "traction", "gap", "errors"),
        needs=("matplotlib",),
    ),
    "pressurised_sphere": Demo(
        "--degree 1 --levels 1",
        {"0.l2": 5.28e-2, "0.stress": 0.306},
        accuracy=0.1,  # Gmsh's mesh
        pictures=("gap_domain", "deformed", "traction"),
        needs=("gmsh",),
    ),
    "pressurised_sphere_hexahedra": Demo(
        "--degree 1 --levels 1 --cell hexahedron --fused",
        {
            **{"0.l2": 6.931e-3, "0.stress": 0.13386, "0.fused.l2": 7.748e-3},
            **{"0.traction": 4.250e-2, "0.surface_traction.0": 1.960e-2},
        },
        script="pressurised_sphere",
        slow=True,  # test_quadrilaterals.test_sphere
    ),
    "read_meshes": Demo(
        pinned={"l2": 3.797e-5, "stress": 2.131e-3, "concentration": 3.0096},
        pictures=("read_meshes",),
        needs=("gmsh",),
    ),
    "plasticity": Demo(
        "--cells 12 --steps 12",
        {"first_yield": 1.58272, "mean_pressure": 2.82820, "imprint": 0.87741}
        | {"springs_back": 0.85250, "dissipated": 0.96638},
        {"energy": 0.03, "newton.*": 9, "newton_back.*": 6, "halvings": 0},
        slow=True,  # the page how-to/plasticity.md has such a law
    ),
    "press_fit": Demo(
        "--fine 1",
        {"pressure": 1.02348, "friction": 0.200727},
        {"each.*": 10, "halvings": 0},
        pictures=("press_fit",),
        needs=("matplotlib",),
    ),
    "rolling": Demo(
        "--step 0.03 --time 1.2",
        {"expected": 0.72342, "speed": 0.7377, "dissipated": 0.2870},
        {"energy_error": 1e-3, "halvings": 0},
        accuracy=1e-2,
        pictures=("rolling",),
        needs=("matplotlib",),
    ),
    "slender_contact": Demo(
        "--scene hertz rollers hairpin squeezed slot",
        {"rows.0.forces.0.1": 4.3500e-2, "rows.3.forces.0.1": 2.4489e-4},
        {"rows.*.newton_steps": 29, "rows.*.halvings": 0},
        pictures=("slender_contact",),
        needs=("matplotlib",),
    ),
    "stability": Demo(
        "--quick",
        pictures=("stability",),
        needs=("matplotlib",),
        slow=True,
        status=1,  # the rows that test_stability.test_all names are not met
    ),
    "contact_conductance": Demo(
        "--cells 12",
        {"crowned.2.heat": 0.26242, "crowned.2.rough": 0.042683, "crowned.7.heat": 0.33344},
        {"even.*.error": 1e-11, "crowned.*.newton": 6},
        accuracy=1e-3,
        pictures=("contact_conductance",),
    ),
    "peeling": Demo(
        "--steps 8",
        {"rows.5.moment": 1.0, "rows.7.moment": 1.0},
        {"rows.*.newton": 7},
        accuracy=1e-4,
        pictures=("peeling",),
    ),
    "periodic_cell": Demo(
        "--fibres",
        {"fibres.shear": 46.004},
        {"rows.*.error": 1e-12, "fibres.matching": 1e-3},
        pictures=("periodic_cell",),
        needs=("gmsh",),
    ),
    "periodic_cell_cubic": Demo(
        "--degree 3", below={"rows.*.error": 2e-12}, slow=True, script="periodic_cell"
    ),
    "periodic_cell_3d": Demo(
        "--dim 3", below={"rows.*.error": 1e-12}, slow=True, script="periodic_cell"
    ),
    "periodic_cell_3d_quadratic": Demo(
        "--dim 3 --degree 2", below={"rows.*.error": 2e-12}, slow=True, script="periodic_cell"
    ),
    "periodic_cell_3d_cubic": Demo(
        "--dim 3 --degree 3", below={"rows.*.error": 2e-12}, slow=True, script="periodic_cell"
    ),
    "thermal_resistance": Demo(
        "--levels 2",
        {"rows.0.error": 1.691e-5, "rows.4.error": 2.00e-6, "rows.6.error": 1.508e-6},
        {"rows.*.flux": 2e-5},
        accuracy=3e-3,
        pictures=("thermal_resistance",),
    ),
    "wave": Demo(
        "--degrees 1 2",
        {"0.error": 0.31441, "1.error": 2.0665e-3, "1.reflected": 7.980e-5},
        {"*.ratio": 1.03},
        complex_numbers=True,
    ),
    "write_files": Demo("FOLDER", {"force.1": -0.1}, accuracy=1e-10, pictures=("write_files",)),
}


def results(content, name):
    """What a name with dots stands for; ``*`` for all rows."""
    found = [content]
    for part in name.split("."):
        if part == "*":
            found = [row for rows in found for row in rows]
        else:
            found = [x[int(part) if isinstance(x, list) else part] for x in found]
    return found


LONG = (
    *("any_assemblies", "any_assemblies_in_space", "any_contacts", "any_contacts_in_space"),
    *("any_assemblies_all", "any_assemblies_in_space_all", "any_assemblies_conforming"),
    *("any_surfaces", "error_against_run_time", "hyperelasticity", "partial_overlap"),
    *("partial_overlap_tetrahedra", "partial_overlap_hexahedra"),
)
"""Run on one rank alone: what is distributed in them is so in others too."""
AS_OTHERS = (
    *("bearing", "benchmarks", "bouncing", "cad_assemblies", "contact_patch", "friction"),
    *("gap_domain", "heat"),
    *("hertz_published", "incompressible", "ironing", "ironing_far", "ironing_snaps"),
    *("hertz", "kernel_speed", "large_contact"),
    "modal_analysis",
    "periodic_cell",
    *("periodic_cell_3d", "pressurised_cylinder", "pressurised_sphere_hexahedra", "read_meshes"),
    *("contact_conductance", "contact_run_time", "peeling", "plasticity", "press_fit"),
    "rolling",
    "slender_contact",
)
"""On ranks they show no more than the sphere or the plane: with ``make test`` on one rank."""


def is_drawn(file):
    """Whether a picture shows something: neither white nor of one colour."""
    pyvista = pytest.importorskip("pyvista")
    pixels = np.asarray(pyvista.read(file).active_scalars)[::7, :3].astype(int)
    colours = np.unique(pixels @ (1, 256, 256**2))
    return (pixels.min(axis=1) < 250).mean() > 0.01 and len(colours) > 30


@pytest.mark.ranks(2, name=[n for n in DEMOS if n not in LONG + (not thorough) * AS_OTHERS])
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow if demo.slow else ()) for n, demo in DEMOS.items()],
)
def test_demo(name, tmp_path, monkeypatch, capfd):
    demo = DEMOS[name]
    if demo.complex_numbers and not np.issubdtype(default_scalar_type, np.complexfloating):
        pytest.skip("needs complex scalars")
    for package in (*demo.needs, *["pyvista"] * bool(demo.pictures)):
        pytest.importorskip(package)
    arguments = [str(tmp_path) if a == "FOLDER" else a for a in demo.arguments.split()]
    arguments += ["--json", str(tmp_path / "results.json")]
    if demo.pictures:
        arguments += ["--plot", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    status = 0
    try:
        runpy.run_path(str(FOLDER / f"{demo.script or name}.py"), run_name="__main__")
    except SystemExit as exit:
        status = exit.code or 0
    assert status == demo.status
    comm.barrier()

    out, err = capfd.readouterr()
    assert not err  # no progress in a pipe, no warnings
    if comm.rank == 0:
        assert out.strip()
    content = json.loads((tmp_path / "results.json").read_text())
    for key, value in demo.pinned.items():
        for result in results(content, key):
            assert result == pytest.approx(value, rel=demo.accuracy), key
    for key, bound in demo.below.items():
        assert max(results(content, key)) <= bound, key
    for picture in demo.pictures:
        assert is_drawn(tmp_path / f"{picture}.png"), picture


def test_every_demo_is_tested_and_listed():
    names = {file.stem for file in FOLDER.glob("*.py")}
    assert names <= set(DEMOS)
    text = (FOLDER / "README.md").read_text()
    assert all(f"({name}.py)" in text for name in names)
    for file in (FOLDER / "pictures").glob("*.png"):
        assert f"(pictures/{file.name})" in text or f'"pictures/{file.name}"' in text
        assert file.stat().st_size < 60_000
