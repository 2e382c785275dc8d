# # Error against run time
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# What does a tie cost? Two scenes with exact solutions, a pressurised cylinder and a pressurised
# sphere, are solved twice on the same geometry: in two bodies whose meshes don't match, tied; and
# on one fused mesh with cells of the same size. This demo shows
#
# - the errors of both over the seconds that they take,
# - where the time goes, and what share of it is the tie's (Σ and the blocks of the constraint),
# - with `--peers`, the same cylinder by scikit-fem's mortar method on a supermesh.
#
# `--scene contact` does the same for Hertz's contact in the plane and in space (`run_time/`): the
# pressure's error over seconds, for small and finite sliding, Newton steps, where the time goes;
# with `--peers` NGSolve and scikit-fem on the same meshes.
#
# Both are solved by `TiedProblem` with its default solver; the fused mesh is a problem without
# ties. Runs alternate between the two, so that a busy machine slows both.

# +
import argparse
import ctypes
import gc
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx
import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
from run_time import contact

import meshes
from hypergap_dolfinx import Tie, TiedProblem

comm = MPI.COMM_WORLD
PARTS = ("Σ", "gap kernel and blocks", "set-up, rows, loads", "stiffness", "factors and solve")

# -

# ## The scenes
#
# Lamé's solutions under the inner pressure one are radial, $u = (A_1 + A_2/r^d)\, x$. Young's
# modulus is one, Poisson's ratio 0.3; plane strain in the cylinder. All radii are 1 : 1.5 : 2.

a, c, b = 1.0, 1.5, 2.0
nu = 0.3
mu, lmbda = 1 / (2 * (1 + nu)), nu / ((1 + nu) * (1 - 2 * nu))


def sigma(u):
    """Stress of a displacement."""
    eps = ufl.sym(ufl.grad(u))
    return 2 * mu * eps + lmbda * ufl.tr(eps) * ufl.Identity(len(u))


def exact_displacement(x):
    """Lamé's solution at a UFL coordinate."""
    if len(x) == 2:
        A, B = a**2 / (b**2 - a**2), a**2 * b**2 / (b**2 - a**2)
        return (1 + nu) * ((1 - 2 * nu) * A + B / ufl.dot(x, x)) * x
    A, B = a**3 / (b**3 - a**3), a**3 * b**3 / (2 * (b**3 - a**3))
    return ((1 - 2 * nu) * A + (1 + nu) * B / ufl.sqrt(ufl.dot(x, x)) ** 3) * x


def interface_pressure(dim):
    """σ_rr where the bodies meet."""
    if dim == 2:
        return (a**2 - a**2 * b**2 / c**2) / (b**2 - a**2)
    return (a**3 - a**3 * b**3 / c**3) / (b**3 - a**3)


# The cylinder's inner ring has 3n quadrilaterals around, the outer one 2n, both n across; the fused
# one 2.5n around and 2n across. The sphere is an octant of unstructured tetrahedra, 1.25 times as
# large in the outer shell. Gmsh decides on their number, so the fused mesh's size is tuned until
# its unknowns differ by less than 1 %.


def rings(n, degree):
    """Two rings that don't match."""
    return [
        meshes.ring_sector(comm, 3 * n, n, a, c, degree=degree),
        meshes.ring_sector(comm, 2 * n, n, c, b, degree=degree),
    ]


def fused_ring(n, degree, num_dofs):
    """The same in one."""
    return [meshes.ring_sector(comm, round(2.5 * n), 2 * n, a, b, degree=degree)]


def shells(h, degree):
    """Two shells that don't match."""
    return [
        meshes.spherical_shell(comm, h, a, c, degree=degree),
        meshes.spherical_shell(comm, 1.25 * h, c, b, degree=degree),
    ]


def fused_shell(h, degree, num_dofs):
    """The same in one."""
    best = None
    for _ in range(6):
        mesh, ft = meshes.nested_shells(comm, (h, 1.25 * h), (a, c, b), degree=degree)
        num = size(fem.functionspace(mesh, ("Lagrange", degree, (3,))))
        if best is None or abs(num - num_dofs) < abs(best[0] - num_dofs):
            best = num, mesh, ft
        if abs(num / num_dofs - 1) < 0.01:
            break
        h *= (num / num_dofs) ** (1 / 3)
    return [best[1:]]


@dataclass(frozen=True)
class Scene:
    """A geometry and its levels."""

    tied: Callable
    """Makes two meshes of a cell size."""
    fused: Callable
    """Makes one of the same size."""
    levels: dict[int, tuple]
    """Cell sizes for each degree."""


SCENES = {
    "cylinder": Scene(
        rings, fused_ring, {1: (16, 32, 64, 128), 2: (8, 16, 32, 64), 3: (8, 16, 32)}
    ),
    "sphere": Scene(
        shells,
        fused_shell,
        {1: (0.16, 0.1, 0.06, 0.0355), 2: (0.3, 0.2, 0.14, 0.1), 3: (0.35, 0.25, 0.18)},
    ),
}

# ## One solve


def size(V):
    """Number of displacements of a space."""
    return V.dofmap.index_map.size_global * V.dofmap.index_map_bs


def elastic_body(mesh, ft, degree, inside):
    """Space, forms and symmetry conditions."""
    dim = mesh.geometry.dim
    V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    n, ds = ufl.FacetNormal(mesh), ufl.Measure("ds", mesh, subdomain_data=ft)
    pressure = fem.Constant(mesh, default_scalar_type(inside))
    form = ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx
    planes = (
        (meshes.END, meshes.START) if dim == 2 else (meshes.PLANE_X, meshes.PLANE_Y, meshes.PLANE_Z)
    )
    bcs = []
    for component, tag in enumerate(planes):
        dofs = fem.locate_dofs_topological(V.sub(component), dim - 1, ft.find(tag))
        bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(component)))
    return V, form, -pressure * ufl.dot(n, v) * ds(meshes.INNER), bcs


@contextmanager
def stopwatch(seconds, name):
    """Seconds of a block, on the slowest rank, into a dictionary; and the processor's in all."""
    comm.barrier()
    start, processor = time.perf_counter(), time.process_time()
    yield
    comm.barrier()
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - start
    seconds["processor"] = seconds.get("processor", 0.0) + time.process_time() - processor


def memory(name):
    """This process's memory in bytes: now (VmRSS) or at its peak (VmHWM)."""
    try:
        status = Path("/proc/self/status").read_text()
        return 1024 * int(status.split(f"{name}:")[1].split()[0])
    except OSError:  # not Linux
        return 0


def forget_peak():
    """Give freed memory back, and count peaks from now on."""
    gc.collect()
    try:
        ctypes.CDLL("libc.so.6").malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        pass


def solve(bodies, degree, solver=None):
    """Solve a scene; returns the problem, its tie if any, and what it took."""
    parts = [elastic_body(*body, degree, float(i == 0)) for i, body in enumerate(bodies)]
    V, forms, loads, bcs = zip(*parts, strict=True)
    forget_peak()
    before = memory("VmRSS")
    seconds, ties = {}, []
    if len(bodies) == 2:
        with stopwatch(seconds, PARTS[0]):
            facets = bodies[0][1].find(meshes.OUTER), bodies[1][1].find(meshes.INNER)
            ties = [Tie((V[0], facets[0]), (V[1], facets[1]))]
        with stopwatch(seconds, PARTS[1]):
            ties[0].blocks()
    with stopwatch(seconds, PARTS[2]):
        problem = TiedProblem(
            forms, loads, bcs=[bc for part in bcs for bc in part], ties=ties, solver=solver
        )
    with stopwatch(seconds, PARTS[3]):
        problem.assemble_matrix()
    with stopwatch(seconds, PARTS[2]):
        problem.assemble_vector()
    with stopwatch(seconds, PARTS[4]):
        problem.solve_system()
    peak = comm.allreduce(max(memory("VmHWM") - before, 0))
    return problem, ties, seconds, peak


# ## Errors
#
# Relative errors of displacement and stress; of the traction λ on Σ, or for the fused mesh of the
# mean of σn from both sides of the facets at the radius of the interface. And the residual of the
# linear system over its right-hand side.


def relative_errors(us, degree):
    """Relative L² errors of displacement and stress."""
    totals = np.zeros(4)
    for u in us:
        u_exact = exact_displacement(ufl.SpatialCoordinate(u.function_space.mesh))
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 4})
        # The zero function's error is the exact field's norm, by the same form
        for j, f in enumerate((u, fem.Function(u.function_space))):
            for i, g in enumerate((f - u_exact, sigma(f) - sigma(u_exact))):
                totals[2 * i + j] += fem.assemble_scalar(fem.form(ufl.inner(g, g) * dx))
    error_u, norm_u, error_s, norm_s = comm.allreduce(totals)
    return float(np.sqrt(error_u / norm_u)), float(np.sqrt(error_s / norm_s))


def traction_error(problem, tie):
    """Relative L² error of λ on Σ."""
    q = tie.quadrature(8)
    normal = q.x / np.linalg.norm(q.x, axis=-1, keepdims=True)
    exact = interface_pressure(q.x.shape[-1]) * normal
    error = q.evaluate(tie.traction(problem)) - exact
    return float(np.sqrt(q.integrate((error**2).sum(-1)) / q.integrate((exact**2).sum(-1))))


def fused_traction_error(u):
    """Relative L² error of the mean σn on the facets at the interface's radius."""
    mesh = u.function_space.mesh
    tdim = mesh.topology.dim
    facets = dolfinx.mesh.locate_entities(
        mesh, tdim - 1, lambda x: np.abs(np.linalg.norm(x, axis=0) - c) < 1e-6
    )
    # Of a facet between ranks neither knows both cells
    facets = np.setdiff1d(facets, mesh.topology.interprocess_facets())
    tags = dolfinx.mesh.meshtags(mesh, tdim - 1, facets, np.ones_like(facets))
    dS = ufl.Measure("dS", mesh, subdomain_data=tags, metadata={"quadrature_degree": 8})
    n = ufl.FacetNormal(mesh)("+")
    exact = interface_pressure(tdim) * n
    error = ufl.dot(ufl.avg(sigma(u)), n) - exact
    totals = [fem.assemble_scalar(fem.form(ufl.inner(f, f) * dS(1))) for f in (error, exact)]
    error, norm = comm.allreduce(np.array(totals))
    return float(np.sqrt(error / norm)) if norm else float("nan")  # all between ranks


def residual(problem):
    """Of the saddle system, relative to its right-hand side."""
    r = problem.b.duplicate()
    problem.A.mult(problem.x, r)
    r.axpy(-1.0, problem.b)
    return r.norm() / problem.b.norm()


# ## A level
#
# Errors are measured once, times several times.


def measure(scene, degree, h, repeats, solver):
    """Both rows of a level."""
    bodies = {"tied": SCENES[scene].tied(h, degree)}
    num = sum(
        size(fem.functionspace(m, ("Lagrange", degree, (m.geometry.dim,))))
        for m, _ in bodies["tied"]
    )
    bodies["fused"] = SCENES[scene].fused(h, degree, num)
    rows = {}
    for repeat in range(repeats):
        for method, parts in bodies.items():
            problem, ties, seconds, peak = solve(parts, degree, solver)
            if repeat == 0:
                l2, stress = relative_errors(problem.u, degree)
                rows[method] = {
                    "scene": scene,
                    "method": method,
                    "degree": degree,
                    "h": h,
                    "dofs": sum(size(u.function_space) for u in problem.u),
                    "l2": l2,
                    "stress": stress,
                    "traction": (
                        traction_error(problem, ties[0])
                        if ties
                        else fused_traction_error(problem.u[0])
                    ),
                    "residual": residual(problem),
                    "solver": problem.solver.getPC().getType(),
                    "iterations": problem.iterations,
                    "runs": [],
                    "peak": peak,
                }
            rows[method]["runs"].append(seconds)
            for obj in (problem, *ties):  # now, on several ranks too
                obj.destroy()
            del problem, ties
    for row in rows.values():
        totals = [total(run) for run in row["runs"]]
        row["total"], row["range"] = float(np.median(totals)), [min(totals), max(totals)]
        row["processor"] = float(np.median([run["processor"] for run in row["runs"]]))
        row["split"] = {
            part: float(np.median([run.get(part, 0.0) for run in row["runs"]])) for part in PARTS
        }
    return list(rows.values())


def total(run):
    """Seconds of all parts of a run."""
    return sum(run.get(part, 0.0) for part in PARTS)


def compile_forms(scene, degree):
    """Seconds that the first solve takes longer than the second: FFCx and the C compiler."""
    h = SCENES[scene].levels[degree][0]
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        bodies = SCENES[scene].tied(h, degree)
        problem, ties, *_ = solve(bodies, degree)
        relative_errors(problem.u, degree)
        traction_error(problem, ties[0])
        seconds.append(time.perf_counter() - start)
    return seconds[0] - seconds[1]


# ## A peer
#
# scikit-fem's mortar method on a supermesh of the interface, on the same rings with the same
# elements. The supermesh lives in the angle, and a form on two bases takes the measure of its trial
# functions: so these are the multipliers' side in both blocks.


def solve_with_scikit_fem(n):
    """A row of the cylinder with Q2."""
    import scipy.sparse as sp
    import skfem
    from skfem.helpers import ddot, dot, sym_grad, trace
    from skfem.supermeshing import elementwise_quadrature, intersect

    start, processor = time.perf_counter(), time.process_time()
    element = skfem.ElementVector(skfem.ElementQuad2())
    bases = []
    for num_hoop, r in ((3 * n, (a, c)), (2 * n, (c, b))):
        square = skfem.MeshQuad.init_tensor(
            np.linspace(*r, n + 1), np.linspace(0, np.pi / 2, num_hoop + 1)
        )
        mesh = skfem.MeshQuad2.from_mesh(square)
        radius, angle = mesh.doflocs
        x = np.vstack((radius * np.cos(angle), radius * np.sin(angle)))
        bases.append(skfem.Basis(skfem.MeshQuad2(x, mesh.t), element, intorder=4))

    @skfem.BilinearForm
    def stiffness(u, v, w):
        e, d = sym_grad(u), sym_grad(v)
        return 2 * mu * ddot(e, d) + lmbda * trace(e) * trace(d)

    def at(mesh, r):
        """Boundary facets at a radius."""
        return mesh.facets_satisfying(
            lambda x: np.abs(np.hypot(*x) - r) < 0.1 / n, boundaries_only=True
        )

    facets = [at(basis.mesh, c) for basis in bases]
    traces = [
        basis.mesh.trace(f, mtype=skfem.MeshLine, project=lambda x: np.arctan2(x[1], x[0])[None])
        for basis, f in zip(bases, facets, strict=True)
    ]
    supermesh, *hosts = intersect(traces[0][0], traces[1][0])
    sides = [
        skfem.FacetBasis(
            basis.mesh,
            element,
            quadrature=elementwise_quadrature(line, supermesh, host, intorder=6),
            facets=found[host],
        )
        for basis, (line, found), host in zip(bases, traces, hosts, strict=True)
    ]
    mass = skfem.BilinearForm(lambda u, v, w: dot(u, v))
    held = [
        np.concatenate(
            [basis.get_dofs(lambda x, i=i: x[1 - i] < 1e-9).all(f"u^{2 - i}") for i in (0, 1)]
        )
        for basis in bases
    ]
    rows = np.setdiff1d(bases[1].get_dofs(facets[1]).all(), held[1])
    B0 = -mass.assemble(sides[1], sides[0]).T[rows]
    B1 = mass.assemble(sides[1], sides[1])[rows]
    inner = skfem.FacetBasis(bases[0].mesh, element, facets=at(bases[0].mesh, a), intorder=6)
    load = skfem.LinearForm(lambda v, w: -dot(w.n, v)).assemble(inner)
    K = [stiffness.assemble(basis) for basis in bases]
    A = sp.bmat([[K[0], None, B0.T], [None, K[1], B1.T], [B0, B1, None]], format="csr")
    f = np.concatenate((load, np.zeros(A.shape[0] - len(load))))
    system = skfem.condense(A, f, D=np.concatenate((held[0], bases[0].N + held[1])))
    assembled = time.perf_counter()
    x = skfem.solve(*system)
    solved, processor = time.perf_counter(), time.process_time() - processor

    error = norm = 0.0
    A1, A2 = a**2 / (b**2 - a**2), a**2 * b**2 / (b**2 - a**2)
    for basis, u in zip(bases, np.split(x[: bases[0].N + bases[1].N], [bases[0].N]), strict=True):
        fine = skfem.Basis(basis.mesh, element, intorder=8)
        points = np.array(fine.global_coordinates())
        exact = (1 + nu) * ((1 - 2 * nu) * A1 + A2 / (points**2).sum(axis=0)) * points
        error += ((fine.interpolate(u).value - exact) ** 2 * fine.dx).sum()
        norm += (exact**2 * fine.dx).sum()
    dofs = int(bases[0].N + bases[1].N)
    return float(np.sqrt(error / norm)), dofs, solved - start, assembled - start, processor


def measure_peer(n, repeats):
    """A row of scikit-fem, and one of ours from runs between its runs."""
    runs, ours = [], []
    processor = [], []
    for _ in range(repeats):
        l2, dofs, whole, assembled, busy = solve_with_scikit_fem(n)
        processor[0].append(busy)
        runs.append({"assembly": assembled, "solve": whole - assembled})
        bodies = rings(n, 2)
        problem, _, seconds, _ = solve(bodies, 2)
        ours.append(total(seconds))
        processor[1].append(seconds["processor"])
        own = relative_errors(problem.u, 2)[0]
        del problem
    median = float(np.median([sum(run.values()) for run in runs]))
    return {
        "scene": "cylinder",
        "method": "scikit-fem mortar",
        "degree": 2,
        "h": n,
        "dofs": dofs,
        "l2": l2,
        "total": median,
        "runs": runs,
        "processor": float(np.median(processor[0])),
        "ours": {
            "processor": float(np.median(processor[1])),
            "l2": own,
            "total": float(np.median(ours)),
            "runs": ours,
        },
    }


# ## The report


def header():
    """Machine, versions, ranks and threads."""
    cpu = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((x.split(":")[1].strip() for x in lines if x.startswith("model name")), cpu)
    return {
        "machine": f"{cpu}, {os.cpu_count()} cores, {platform.system()} {platform.release()}",
        "versions": f"Python {platform.python_version()}, DOLFINx {dolfinx.__version__}, "
        f"PETSc {'.'.join(map(str, PETSc.Sys.getVersion()))}, NumPy {np.__version__}",
        "ranks": comm.size,
        "threads a rank": os.environ.get("OMP_NUM_THREADS", "not limited (OMP_NUM_THREADS)"),
    }


def print_level(rows):
    """Tied, fused, and the ratio."""
    for row in rows:
        split = "  ".join(f"{row['split'][part]:7.3f}" for part in PARTS)
        print(
            f"{row['method']:6s} {row['h']:>7} {row['dofs']:>8d}  {row['l2']:.3e}  "
            f"{row['stress']:.3e}  {row['traction']:.2e}  {row['residual']:.0e}  "
            f"{row['total']:8.3f} "
            f"[{row['range'][0]:.3f}, {row['range'][1]:.3f}]  {split}  {row['peak'] / 2**20:6.0f}"
            f"  {row['solver']} {row['iterations']}"
        )
    tied, fused = rows
    share = (tied["split"][PARTS[0]] + tied["split"][PARTS[1]]) / tied["total"]
    print(
        f"       tied / fused: dofs {tied['dofs'] / fused['dofs']:.3f}, "
        f"seconds {tied['total'] / fused['total']:.3f} "
        f"(fastest {tied['range'][0] / fused['range'][0]:.3f}, "
        f"processor {tied['processor'] / fused['processor']:.3f}), "
        f"memory {tied['peak'] / max(fused['peak'], 1):.2f}; "
        f"Σ and gap: {100 * share:.1f} % of tied",
        flush=True,
    )


def draw(rows, peers, folder):
    """Error over seconds; where the time goes; the price over the number of unknowns."""
    from matplotlib import pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    for scene in dict.fromkeys(row["scene"] for row in rows):
        draw_scene(plt, scene, [r for r in rows if r["scene"] == scene], peers, folder)


def draw_scene(plt, scene, rows, peers, folder):
    """The figure of a scene."""
    from matplotlib.ticker import NullFormatter

    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(15, 5), width_ratios=(1.5, 1, 1), constrained_layout=True
    )
    dim = 2 if scene == "cylinder" else 3
    degrees = sorted({row["degree"] for row in rows})
    colors = dict(zip((1, 2, 3), ("tab:blue", "tab:orange", "tab:green"), strict=True))
    for degree in degrees:
        for method, style in (("tied", "o-"), ("fused", "s--")):
            part = [r for r in rows if r["degree"] == degree and r["method"] == method]
            t, e = [r["processor"] for r in part], [r["l2"] for r in part]
            fill = colors[degree] if method == "tied" else "white"
            left.loglog(
                t, e, style, color=colors[degree], mfc=fill, label=f"degree {degree}, {method}"
            )
        # Work in proportion to the unknowns would give errors ~ seconds^(-(k + 1) / dim)
        t = np.array([part[-1]["processor"] / 8, part[-1]["processor"]])
        order = (degree + 1) / dim
        left.loglog(t, 0.45 * part[-1]["l2"] * (t / t[-1]) ** -order, ":", color=colors[degree])
        left.annotate(
            f"−{degree + 1}/{dim}", (t[0], 0.45 * part[-1]["l2"] * 8**order), fontsize=8,
            color=colors[degree], ha="right", va="center",
        )  # fmt: skip
    shown = [p for p in peers if scene == "cylinder"]
    if shown:
        t, e = [p["processor"] for p in shown], [p["l2"] for p in shown]
        left.loglog(t, e, "x-", color="tab:red", label="degree 2, scikit-fem mortar")
    floor = 1e-13
    left.axhspan(floor / 30, floor, color="0.9")
    left.text(0.02, 0.02, "round-off", transform=left.transAxes, fontsize=8, color="0.4")
    left.set_ylim(bottom=floor / 10)
    left.set(xlabel="seconds of the processor", ylabel="relative L² error of the displacement")
    left.set_title(f"{scene}: error over run time")
    left.grid(which="major", alpha=0.3)
    left.legend(fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0, 0.1))

    finest = [
        [r for r in rows if r["degree"] == d and r["method"] == m][-1]
        for d in degrees
        for m in ("fused", "tied")
    ]
    bottom = np.zeros(len(finest))
    shades = ("tab:red", "tab:pink", "0.8", "tab:cyan", "tab:purple")
    for name, shade in zip(PARTS, shades, strict=True):
        height = np.array([row["split"][name] * row["processor"] / row["total"] for row in finest])
        middle.bar(range(len(finest)), height, bottom=bottom, color=shade, label=name)
        bottom += height
    middle.set_xticks(
        range(len(finest)),
        [f"{r['method']}\ndeg. {r['degree']}\n{r['dofs'] / 1000:.0f} k" for r in finest],
        fontsize=8,
    )
    middle.set(ylabel="seconds of the processor", title="where the time goes, finest level")
    middle.set_ylim(top=1.3 * bottom.max())  # room for the legend
    handles, labels = middle.get_legend_handles_labels()
    middle.legend(handles[::-1], labels[::-1], fontsize=8, ncols=2, loc="upper left")

    for degree in degrees:
        pairs = [
            [r for r in rows if r["degree"] == degree and r["method"] == m]
            for m in ("tied", "fused")
        ]
        ratio = [t["processor"] / f["processor"] for t, f in zip(*pairs, strict=True)]
        right.semilogx(
            [r["dofs"] for r in pairs[0]],
            ratio,
            "o-",
            color=colors[degree],
            label=f"degree {degree}",
        )
    bound = 1.1 if scene == "cylinder" else 1.25
    right.axhline(1, color="0.4", lw=0.8)
    right.axhline(bound, color="0.4", lw=0.8, ls="--")
    right.text(right.get_xlim()[0], bound, f" {bound}", va="bottom", fontsize=8, color="0.4")
    right.set_ylim(bottom=0)
    right.set(xlabel="displacements", ylabel="tied / fused", title="the price of the tie")
    right.grid(alpha=0.3)
    right.legend(fontsize=8)
    for axes in (left, right):
        axes.xaxis.set_minor_formatter(NullFormatter())
    figure.savefig(folder / f"{scene}.png", dpi=150)
    plt.close(figure)


def main():
    """Sweep scenes, degrees and levels."""
    parser = argparse.ArgumentParser(description="Error against run time, tied and fused.")
    parser.add_argument("--scene", choices=(*SCENES, "contact", "all"), default="all")
    parser.add_argument("--degrees", default="1,2", metavar="1,2,3")
    parser.add_argument("--levels", type=int, default=4, help="the coarsest so many")
    parser.add_argument("--finest", action="store_true", help="the finest of these alone")
    parser.add_argument("--sizes", metavar="0.05,0.02", help="n, h, a / h instead of levels")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--solver", choices=("direct", "bodies", "iterative"), help="of both")
    parser.add_argument("--dims", default="2,3", metavar="2,3", help="of contact")
    parser.add_argument("--large", metavar="8,13,22", help="a / h of contact, with both solvers")
    parser.add_argument("--peers", action="store_true", help="other codes too")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args()
    first = comm.rank == 0
    info, rows, peers, jit = header(), [], [], {}

    def chosen(levels, number):
        """The levels that are asked for."""
        levels = levels[: args.levels]
        if args.sizes:
            levels = tuple(number(h) for h in args.sizes.split(","))
        return levels[-1:] if args.finest else levels

    if first:
        print("\n".join(f"{name}: {value}" for name, value in info.items()))
    tied = SCENES if args.scene == "all" else [name for name in SCENES if name == args.scene]
    for scene in tied:
        for degree in (int(d) for d in args.degrees.split(",")):
            jit[f"{scene}, degree {degree}"] = compile_forms(scene, degree)
            if first:
                print(
                    f"\n{scene}, degree {degree} (compiling the forms took "
                    f"{jit[f'{scene}, degree {degree}']:.1f} s, not counted below)\n"
                    "          n, h     dofs  L² displ.  L² stress  L² trac.  resid.  median "
                    f"[range] s   {' | '.join(PARTS)} | peak MiB | solver, iterations"
                )
            number = int if scene == "cylinder" else float
            for h in chosen(SCENES[scene].levels[degree], number):
                level = measure(scene, degree, h, args.repeats, args.solver)
                if first:
                    print_level(level)
                rows += level
    if args.peers and comm.size == 1 and args.scene != "contact":
        print("\nscikit-fem's mortar method on a supermesh, cylinder, degree 2, and ours beside it")
        for n in chosen(SCENES["cylinder"].levels[2], int):
            peers.append(measure_peer(n, args.repeats))
            peer, ours = peers[-1], peers[-1]["ours"]
            print(
                f"{n:4d} {peer['dofs']:>8d}  {peer['l2']:.4e} in {peer['total']:.3f} s; ours "
                f"{ours['l2']:.4e} in {ours['total']:.3f} s: "
                f"{ours['total'] / peer['total']:.3f} "
                f"(processor {ours['processor'] / peer['processor']:.3f})",
                flush=True,
            )
    pressed = []
    solvers = [args.solver] if args.solver else ["iterative", "direct"]
    big = contact.large(comm, list(map(int, args.large.split(","))), solvers) if args.large else []
    if args.scene in ("contact", "all") and not args.large:
        dims = [int(dim) for dim in args.dims.split(",")]
        degrees = [int(d) for d in args.degrees.split(",") if int(d) < 3]
        pressed = contact.report(comm, dims, degrees, chosen, args.repeats, args.peers)
    if first and args.json:
        report = {
            **info,
            "compiling": jit,
            "rows": rows,
            "peers": peers,
            "contact": pressed,
            "large": big,
        }
        args.json.write_text(json.dumps(report, indent=1, ensure_ascii=False))
    if first and args.plot:
        if rows:
            draw(rows, peers, args.plot)
        if big:
            contact.draw_large(big, args.plot)
        if pressed:
            contact.draw(pressed, args.plot)
        print(f"\npictures in {args.plot}/")


if __name__ == "__main__":
    main()
