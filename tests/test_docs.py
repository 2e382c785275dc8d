# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""The examples in the docstrings of what the package exports."""

import doctest

import hypergap_dolfinx


def test_examples():
    """In this order: each goes on where the one before ended."""
    runner, names = doctest.DocTestRunner(), {}
    for name in ("Tie", "TiedProblem", "NonlinearTiedProblem"):
        text = getattr(hypergap_dolfinx, name).__doc__
        example = doctest.DocTestParser().get_doctest(text, names, name, None, None)
        assert len(example.examples) > 3
        runner.run(example, clear_globs=False)
        names = example.globs
    assert runner.summarize(verbose=False) == (0, runner.tries)
