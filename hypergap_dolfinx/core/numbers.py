# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Numbers of what occurs several times, and of lots of many.

NumPy's ``unique`` of rows takes ten times as long, or more.
"""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

LOT = 20_000  # things whose numbers fit into the processor's cache


def used(numbers: npt.NDArray[np.integer]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Those of some numbers from 0 on that occur, in rising order; and the place of each there.

    Without sorting: for numbers that aren't much larger than there are many of them.
    """
    there = np.zeros(int(numbers.max(initial=-1)) + 1, dtype=bool)
    there[numbers] = True
    return np.flatnonzero(there), (np.cumsum(there) - 1)[numbers]


def row_codes(rows: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """A number for each row of numbers from 0 on, ``(num, …)``: rows in order have rising ones."""
    code, size = np.zeros(len(rows), dtype=np.int64), int(rows.max(initial=0)) + 1
    for column in rows.T:
        if int(code.max(initial=0)) * size >= 2**62:
            code = np.unique(code, return_inverse=True)[1]
        code = code * size + column
    return code


def lots(num: int) -> Iterator[slice]:
    """Lots of many things: what is computed of one lot at a time needs hardly any memory."""
    for start in range(0, num, LOT):
        yield slice(start, min(start + LOT, num))
