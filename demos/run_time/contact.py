# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Hertz's contact: the pressure's error over seconds, where these go, and other codes beside it.

Meshes and function spaces are made before the watch starts, for all codes; forms are compiled by a
run before. The pressure is what a code itself calls it, at the points of a rule on the block's
surface. Rows are means over four places of the contact's edge between the nodes, so that no code
has it on one. Other codes have a number to choose, a penalty or that of Nitsche's method: there is
a row with what their authors use, and one with the best of a list, each time. What trying costs is
not counted. They start from bodies that overlap by a²/R, as Hertz's approach each other.
"""

import cProfile
import importlib
import pstats
import time
from pathlib import Path
from resource import RUSAGE_SELF, getrusage

import hertz
import numpy as np

from hypergap_dolfinx import Contact, ContactProblem
from run_time.copies import row

NAME = "hypergap"
PARTS = ("set-up", "bodies' assembly", "Σ, gaps, derivatives", "factors and solve", "rest")
RATIO = 2 / 3  # round body's cells over the block's
LEVELS = {(2, 1): (5, 10, 20, 40), (2, 2): (3, 5, 10), (3, 1): (3, 4, 6, 8), (3, 2): (2, 3, 4)}
"""Of each dimension and degree a / h."""
NUMBERS = {1: (0.3, 1.0, 3.0), 2: (3.0, 10.0, 30.0)}
"""Of each degree what other codes try, over E / h, beside their authors' numbers."""
MOVED = (1 / 8, 3 / 8, 5 / 8, 7 / 8)
"""Places of the contact's edge, in cells behind a node: added to a / h."""
PEERS = ("in_ngsolve", "in_scikit_fem")


def stopwatch():
    """Start; what is returned gives the seconds and the processor's."""
    start, processor = time.perf_counter(), time.process_time()
    return lambda: {
        "total": time.perf_counter() - start,
        "processor": time.process_time() - processor,
    }


def solve(bodies, degree, sliding):
    """Press the round body on the block.

    Args:
        bodies: What ``hertz.pair`` gives.
        degree: Of displacements.
        sliding: ``"small"`` or ``"finite"``.

    Returns:
        A row of results.
    """
    F, u, bcs, (below, above) = hertz.forms(bodies, degree)
    stop = stopwatch()
    contact = Contact(above, below, sliding=sliding)  # the block has the larger cells
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    problem.solve()
    times = stop()

    surface, p = contact.surfaces[1], contact.pressures(problem)
    dim = surface.gdim
    shares, at, dx = hertz.quadrature(surface.x[surface.facets])
    fine = hertz.surface_error(problem, contact)
    dofs = sum(w.function_space.dofmap.index_map.size_global * dim for w in u)
    found = row(
        f"{NAME}, {sliding} sliding", dim, degree, at, p[surface.facets] @ shares.T, dx,
        dofs=dofs, steps=problem.iterations, **times,
    )  # fmt: skip
    problem.destroy()
    return {**found, "l2_vertices": found["l2_pressure"], "l2_pressure": float(fine)}


def part_of(function):
    """The part of the time that a function belongs to, by its file and name, or None."""
    file, _, name = function
    file = Path(file).as_posix()
    if "/hypergap_dolfinx/contact_geometry/" in file or "/hypergap_dolfinx/surface/" in file:
        return PARTS[2]
    if "/hypergap_dolfinx/" in file and name in ("assemble_matrix", "_residual"):
        return PARTS[1]
    if file.endswith("/algebra/saddle.py") and name == "solve":
        return PARTS[3]
    return None


def shares(bodies, degree, sliding):
    """Shares of the processor's time, of a run under Python's profiler.

    The profiler makes many small calls longer than a few large ones: Σ's share is rather less.
    """
    profile = cProfile.Profile(time.process_time)
    F, u, bcs, (below, above) = hertz.forms(bodies, degree)
    seconds = dict.fromkeys(PARTS, 0.0)
    start = time.process_time()
    profile.enable()
    contact = Contact(above, below, sliding=sliding)
    before = time.process_time()
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    seconds[PARTS[0]] = time.process_time() - before
    problem.solve()
    profile.disable()
    whole = time.process_time() - start
    problem.destroy()
    for function, (*_, callers) in pstats.Stats(profile).stats.items():
        part = part_of(function)
        if part:
            seconds[part] += sum(c[3] for by, c in callers.items() if part_of(by) != part)
    seconds[PARTS[4]] = whole - sum(seconds.values())
    return {part: s / whole for part, s in seconds.items()}


def median(runs):
    """The first row with the medians of all rows' seconds."""
    times = {name: [run[name] for run in runs] for name in ("total", "processor")}
    return {
        **runs[0],
        **{name: float(np.median(part)) for name, part in times.items()},
        "range": [min(times["total"]), max(times["total"])],
    }


def mean(rows):
    """The first row with means of all rows' errors and seconds, and the most steps."""
    names = [name for name in rows[0] if name.startswith(("l2_", "p0", "force"))]
    averages = {
        name: float(np.mean([row[name] for row in rows])) for name in (*names, "total", "processor")
    }
    ends = [t for row in rows for t in row.get("range", [row["total"]])]
    worst = {"steps": max(row["steps"] for row in rows), "range": [min(ends), max(ends)]}
    return {
        **rows[0], **averages, **worst,
        "converged": all(row.get("converged", True) for row in rows),
    }  # fmt: skip


def measure(moved, degree, division, repeats):
    """Rows of this package, of a level."""
    rows = []
    for sliding in ("small", "finite"):
        found = mean([median([solve(b, degree, sliding) for _ in range(repeats)]) for b in moved])
        found["split"] = shares(moved[0], degree, sliding)
        rows.append({**found, "h_over_a": 1 / division})
    return rows


def measure_peer(peer, moved, degree, division):
    """A code's rows: with its authors' number, and with that of the smallest error."""
    dim = moved[0][0][0].geometry.dim
    numbers = sorted({*NUMBERS[degree], peer.AUTHORS[dim, degree]})
    tried = {k: mean([peer.solve(b, degree, k, stopwatch) for b in moved]) for k in numbers}
    ended = [found for found in tried.values() if found["converged"]]
    authors = tried[peer.AUTHORS[dim, degree]]
    best = min(ended, key=lambda found: found["l2_pressure"], default=authors)
    return [
        {**found, "method": f"{peer.NAME}, {kind} number", "h_over_a": 1 / division}
        for kind, found in {"authors'": authors, "best": best}.items()
    ]


def large(comm, sizes, solvers):
    """Hertz's contact in space, degree 1, with factors and by multigrid.

    Args:
        comm: Communicator.
        sizes: Of the levels a / h.
        solvers: Those to take; the one with the smaller memory first.

    Returns:
        The rows.
    """
    rows = []
    if comm.rank == 0:
        print("\nlarge contact\n         h/a      dofs  steps  iterations  processor's s  peak MiB")
    for division in sizes:
        bodies = hertz.pair(comm, hertz.a / division, 1, RATIO, 3)
        for solver in solvers:
            F, u, bcs, (below, above) = hertz.forms(bodies, 1)
            stop = stopwatch()
            problem = ContactProblem(F, u, bcs=bcs, contacts=[Contact(above, below)], solver=solver)
            problem.solve()
            row = {
                "solver": solver,
                "h_over_a": 1 / division,
                "dofs": sum(w.function_space.dofmap.index_map.size_global * 3 for w in u),
                "steps": problem.iterations,
                "iterations": sum(r.iterations for r in problem.history[-1].steps),
                "processor": stop()["processor"],
                "peak": getrusage(RUSAGE_SELF).ru_maxrss / 1024,
            }
            rows.append(row)
            problem.destroy()
            if comm.rank == 0:
                print(
                    f"{solver:<9} 1/{division:<3} {row['dofs']:>8} {row['steps']:>6} "
                    f"{row['iterations']:>11} {row['processor']:>14.2f} {row['peak']:>9.0f}",
                    flush=True,
                )
    return rows


def draw_large(rows, folder):
    """Seconds over displacements, with factors and by multigrid."""
    from matplotlib import pyplot as plt

    figure, ax = plt.subplots(figsize=(6, 4.5), constrained_layout=True)
    for solver in ("direct", "iterative"):
        some = [row for row in rows if row["solver"] == solver]
        ax.loglog(
            [r["dofs"] for r in some],
            [r["processor"] for r in some],
            "o-",
            label=f'solver="{solver}"',
        )
    ax.set(xlabel="displacements", ylabel="seconds of the processor", title="Hertz: a sphere")
    ax.grid(which="both", alpha=0.25)
    ax.legend()
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "large_contact.png", dpi=150)
    plt.close(figure)


def peers():
    """The codes that are there; those that aren't are named."""
    there = []
    for name in PEERS:
        try:
            there.append(importlib.import_module(f"run_time.{name}"))
        except ImportError as error:
            print(f"left out: {name.removeprefix('in_')} ({error}; see demos/README.md)")
    return there


def print_row(row):
    """A line of the table."""
    split = "  ".join(f"{100 * s:3.0f} %" for s in row.get("split", {}).values())
    number = f"{row['number']:g} E/h" if "number" in row else ""
    number += "" if row.get("converged", True) else ", no end"
    print(
        f"{row['method']:<27} 1/{round(1 / row['h_over_a']):<3} {row['dofs']:>7}  "
        f"{row['l2_pressure']:.2e}  {row['p0']:.2e}  {row['force']:.1e}  {row['steps']:>3}  "
        f"{row['total']:8.3f} [{row['range'][0]:.3f}, {row['range'][1]:.3f}]  "
        f"{row['processor']:8.3f}  {split}{number}",
        flush=True,
    )


def report(comm, dims, degrees, chosen, repeats, compare):
    """Sweep dimensions, degrees and levels.

    Args:
        comm: Communicator.
        dims: Numbers of dimensions.
        degrees: Of displacements.
        chosen: Gives those of some levels that are asked for.
        repeats: Runs of each, of which the medians count.
        compare: Whether other codes run too.

    Returns:
        The rows.
    """
    rows, first = [], comm.rank == 0
    others = peers() if compare and comm.size == 1 else []
    for dim in dims:
        for degree in degrees:
            levels = chosen(LEVELS[dim, degree], int)
            bodies = hertz.pair(comm, hertz.a / levels[0], degree, RATIO, dim)
            solve(bodies, degree, "small")  # compiles the forms
            if first:
                print(
                    f"\ncontact, {dim}D, degree {degree}\n{'':<27} h/a      dofs  L² of p   p0    "
                    f"    force    steps  median [range] s   processor's  {' | '.join(PARTS)}"
                )
            for division in levels:
                moved = [
                    hertz.pair(comm, hertz.a / (division + off), degree, RATIO, dim)
                    for off in MOVED
                ]
                level = measure(moved, degree, division, repeats)
                for peer in others:
                    if dim in peer.DIMS:
                        level += measure_peer(peer, moved, degree, division)
                rows += level
                for found in level if first else ():
                    print_row(found)
    if first and others:
        print_ratios(rows)
    return rows


def curves(rows, dim):
    """Rows of one dimension, by method and degree."""
    found = {}
    for r in rows:
        if r["dim"] == dim and r.get("converged", True):
            found.setdefault((r["method"], r["degree"]), []).append(r)
    return found


def seconds_at(curve, error):
    """The processor's seconds at an error, in between the levels; None beyond them."""
    e, t = (np.log([r[name] for r in curve]) for name in ("l2_pressure", "processor"))
    order = np.argsort(e)
    if not e.min() <= np.log(error) <= e.max():
        return None
    return float(np.exp(np.interp(np.log(error), e[order], t[order])))


def print_ratios(rows):
    """Seconds over the others' at the same error, in between the levels."""
    for dim in sorted({r["dim"] for r in rows}):
        found = curves(rows, dim)
        print(f"\n{dim}D: seconds of the processor over the others' fastest at the same error")
        for (method, degree), curve in found.items():
            if not method.startswith(NAME):
                continue
            for r in curve:
                theirs = {
                    f"{other}, degree {k}": seconds_at(part, r["l2_pressure"])
                    for (other, k), part in found.items()
                    if not other.startswith(NAME)
                }
                theirs = {name: t for name, t in theirs.items() if t}
                if theirs:
                    name = min(theirs, key=theirs.get)
                    print(
                        f"{method}, degree {degree}, {r['l2_pressure']:.2e} in "
                        f"{r['processor']:.3f} s: {r['processor'] / theirs[name]:.2f} ({name})"
                    )


def draw(rows, folder):
    """Error over seconds for each dimension, and where the time goes."""
    from matplotlib import pyplot as plt
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    dims = sorted({r["dim"] for r in rows})
    figure, axes = plt.subplots(
        1, len(dims) + 1, figsize=(5.2 * len(dims) + 4.8, 5), constrained_layout=True
    )
    colors = {NAME: "tab:blue", "NGSolve": "tab:orange", "scikit-fem": "tab:red"}
    for ax, dim in zip(axes, dims, strict=False):
        for (method, degree), curve in curves(rows, dim).items():
            kind, which = method.split(", ")
            style = "--" if which.startswith(("small", "authors")) else "-"
            ax.loglog(
                [r["processor"] for r in curve],
                [r["l2_pressure"] for r in curve],
                style,
                color=colors[kind],
                marker="o" if degree == 1 else "s",
                mfc="white" if degree == 1 else colors[kind],
                label=f"{method}, degree {degree}",
            )
        ax.set(xlabel="seconds of the processor", ylabel="relative L² error of the pressure")
        ax.set_title("Hertz: a cylinder" if dim == 2 else "Hertz: a sphere")
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.grid(which="both", alpha=0.25)
        ax.legend(fontsize=7)
    own = {
        (dim, method, degree): curve[-1]
        for dim in dims
        for (method, degree), curve in curves(rows, dim).items()
        if method.startswith(NAME)
    }
    bottom = np.zeros(len(own))
    for part, shade in zip(
        PARTS, ("0.5", "tab:cyan", "tab:blue", "tab:purple", "0.8"), strict=True
    ):
        height = np.array([100 * r["split"][part] for r in own.values()])
        axes[-1].bar(range(len(own)), height, bottom=bottom, color=shade, label=part)
        bottom += height
    axes[-1].set_xticks(
        range(len(own)),
        [f"{d}D\ndeg. {k}\n{m.split()[1]}\n{r['processor']:.1f} s" for (d, m, k), r in own.items()],
        fontsize=7,
    )
    axes[-1].set(ylabel="% of the processor's time", title="where it goes, finest level")
    axes[-1].set_ylim(top=125)
    axes[-1].legend(fontsize=8, ncols=2, loc="upper left")
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "contact.png", dpi=150)
    plt.close(figure)
