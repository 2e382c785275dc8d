# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What lets the tests run on any number of ranks: ``mpirun -n 3 python -m pytest``.

The ranks meet after each phase of a test (set-up, call, tear-down), agree on its outcome, and rank
0 reports what happened on all of them. A rank that the others wait for in vain ends the whole run.

On more than one rank only those tests run that can notice it: marked with ``ranks``; with
``ranks(2)`` if two ranks show it all; with ``ranks(degree=[1, 2])`` for these parameters alone.
"""

import faulthandler
import functools
import gc
import importlib.metadata
import os
import sys
import threading
import time
from collections import defaultdict

from mpi4py import MPI

# With threads, PT-Scotch cuts the same mesh in another way each time (Debian's): tests that make a
# mesh twice would compare vectors whose entries are other points
os.environ.setdefault("SCOTCH_PTHREAD_NUMBER", "1")

import pytest
from _pytest.terminal import TerminalReporter

import dolfinx.jit

pytest.register_assert_rewrite("assembly", "helpers")  # for the values in what fails

TIMEOUT, TIMEOUT_SLOW = 300, 1800
"""Seconds after which a phase of a test has hung."""
OUTCOMES = ("passed", "failed", "error", "skipped", "xfailed", "deselected")
PATIENCE = 60
"""Seconds that a rank on which a test failed waits for the others."""

try:
    from hypothesis import settings
except ImportError:
    pass
else:
    # The same examples on every rank and in every run
    settings.register_profile("ranks", derandomize=True, database=None, deadline=None)
    settings.load_profile("ranks")

# Compiled with -O0, tests of many or large cells take half as long again; with -O2 compiling takes
# a third longer. Processes that need the same form wait for one another (pytest-xdist)
dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS.update(
    cffi_extra_compile_args=(["-O1", "-g0"], "tests"), timeout=(TIMEOUT, "tests")
)
# setuptools looks six times through all that is installed for each kernel: a fifth of its time
importlib.metadata.entry_points = functools.cache(importlib.metadata.entry_points)

# A communicator of their own: the ranks' meeting is never taken for a collective of the test
world = MPI.COMM_WORLD.Dup()
parallel = world.size > 1
collect_errors: list[str] = []
num_modules = 0


class Watchdog:
    """Ends all ranks when a test hangs, and says which test, on which rank, and where."""

    def __init__(self):
        self.stderr = os.dup(2)  # pytest captures the usual one
        self.timer = None

    def start(self, seconds, message):
        self.stop()
        self.timer = threading.Timer(seconds, self.bark, (seconds, message))
        self.timer.daemon = True
        self.timer.start()
        # Needs no interpreter lock: for a rank that hangs in C++, where no Python thread runs
        faulthandler.dump_traceback_later(seconds + 10, exit=True, file=self.stderr)

    def stop(self):
        faulthandler.cancel_dump_traceback_later()
        if self.timer is not None:
            self.timer.cancel()

    def bark(self, seconds, message):
        text = f"\nrank {world.rank} of {world.size} after {seconds} s: {message}\n"
        os.write(self.stderr, text.encode())
        faulthandler.dump_traceback(file=self.stderr)
        time.sleep(2)  # for the other ranks' words, and for mpirun to pass them on
        MPI.COMM_WORLD.Abort(1)


def ranks_that_say(texts):
    """Each different text of the ranks once, under the ranks that say it."""
    ranks = defaultdict(list)
    for rank, text in enumerate(texts):
        if text:
            ranks[text].append(str(rank))
    return [(f"rank {', '.join(r)} of {len(texts)}", text) for text, r in ranks.items()]


def reason(text):
    """First line of an error in what pytest says of a test, for the summary's one line."""
    lines = text.splitlines() or [""]
    return next((line[1:].strip() for line in lines if line.startswith("E ")), lines[-1])


@pytest.hookimpl(trylast=True)
def pytest_configure(config):
    import helpers  # not before the options of the JIT compiler are set

    helpers.thorough = not config.option.markexpr
    config.watchdog = Watchdog()
    if world.rank > 0:  # rank 0 speaks for all
        config.pluginmanager.unregister(name="terminalreporter")
        silent = TerminalReporter(config, open(os.devnull, "w"))
        config.pluginmanager.register(silent, "terminalreporter")


def pytest_report_header():
    return f"MPI: {world.size} rank{'s' * parallel}, {MPI.Get_library_version().splitlines()[0]}"


def notices(item):
    """Whether a test can notice the number of ranks."""
    if not parallel:
        return True
    marker = item.get_closest_marker("ranks")
    if marker is None or item.get_closest_marker("serial"):
        return False
    parameters = item.callspec.params if hasattr(item, "callspec") else {}
    wanted = all(parameters[name] in values for name, values in marker.kwargs.items())
    return wanted and world.size <= max(marker.args, default=world.size)


def pytest_ignore_collect(collection_path):
    """Files without a test that notices ranks: to import sympy, pyvista and others takes longer."""
    is_test = parallel and collection_path.match("test_*.py")
    return True if is_test and "ranks" not in collection_path.read_text("utf-8") else None


def pytest_collection_modifyitems(config, items):
    config.hook.pytest_deselected(items=[item for item in items if not notices(item)])
    items[:] = [item for item in items if notices(item)]


def pytest_collectreport(report):
    if report.failed:
        collect_errors.append(report.longreprtext)


def keep_modules():
    """Modules and tests stay: to look through them after each test takes .1 s or more."""
    global num_modules
    if len(sys.modules) > num_modules:
        num_modules = len(sys.modules)
        gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_collection_finish(session):
    gc.collect()
    keep_modules()
    names = [item.nodeid for item in session.items]
    every_names, errors = zip(*world.allgather((names, "\n".join(collect_errors))))
    if any(error != errors[0] for error in errors) or any(n != names for n in every_names):
        said = "\n".join(f"--- {ranks}\n{text}" for ranks, text in ranks_that_say(errors))
        pytest.exit(f"The ranks didn't collect the same tests.\n{said}", returncode=2)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item, nextitem):
    try:
        return (yield)
    finally:
        item.config.watchdog.stop()


def pytest_enter_pdb(config):
    config.watchdog.stop()


def watch(item, phase):
    seconds = TIMEOUT_SLOW if item.get_closest_marker("slow") else TIMEOUT
    item.config.watchdog.start(seconds, f"{item.nodeid} hangs in its {phase}")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item):
    watch(item, "set-up")
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item):
    watch(item, "call")
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item):
    watch(item, "tear-down")
    try:
        return (yield)
    finally:
        gc.collect()  # PETSc objects die on all ranks together: the meeting below is next
        keep_modules()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if not parallel:
        return report
    text = report.longreprtext
    if report.failed:
        message = f"{item.nodeid} failed here and the other ranks hang\n{text}"
        item.config.watchdog.start(PATIENCE, message)
    outcomes, texts = zip(*world.allgather((report.outcome, text)))
    if len(set(outcomes)) > 1:
        said = ranks_that_say(texts)
        reasons = [f"{ranks}: {reason(text)}" for ranks, text in said]
        report.longrepr = "; ".join([f"The ranks don't agree: {', '.join(outcomes)}", *reasons])
        report.outcome = "failed"
        report.sections += said
    elif report.failed:
        report.sections += [said for said in ranks_that_say(texts) if said[1] != text]
    return report


def pytest_terminal_summary(terminalreporter, config):
    """A line for the end of ``make test``: how many tests ran here."""
    file = os.environ.get("TESTS_RAN")
    if not file or world.rank > 0 or hasattr(config, "workerinput"):
        return
    counts = {key: len(terminalreporter.stats.get(key, ())) for key in OUTCOMES}
    where = f"{world.size} rank{'s' * parallel}  {os.environ.get('OPENBLAS_CORETYPE', '')}"
    said = ", ".join(f"{n:4} {key}" for key, n in counts.items() if n or key == "passed")
    os.makedirs(os.path.dirname(file), exist_ok=True)
    with open(file, "a") as out:
        out.write(f"{where:20} {said}\n")


def pytest_internalerror(excrepr):
    if parallel:
        os.write(2, f"\nrank {world.rank}: {excrepr}\n".encode())
        MPI.COMM_WORLD.Abort(3)


@pytest.fixture(scope="session")
def comm():
    """All ranks."""
    return MPI.COMM_WORLD


@pytest.fixture
def tmp_path(tmp_path):
    """An empty folder, the same on every rank."""
    return world.bcast(tmp_path)
