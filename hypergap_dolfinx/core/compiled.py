# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The C in ``c/``: built once with FFCx's compiler, kept in its cache, called with checked arrays.

The headers in ``c/`` are the only description of the interface.
"""

import hashlib
import importlib.machinery
import importlib.util
import os
import re
import sys
import tempfile
import weakref
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import cffi
import numpy as np
import numpy.typing as npt

from dolfinx.jit import get_options

FOLDER = Path(__file__).parents[1] / "c"
HEADERS = {
    "sparse": ("sparse.h", "walls.h"),
    "plane": ("plane.h",),
    "space": ("surface.h", "gap_mesh.h", "space.h"),
}
"""Headers of each library that Python reads."""
SOURCES = {
    "sparse": ["multiply", "walls"],
    "plane": "gaps rays".split(),
    "space": (
        "advance bases blocks check columns depths front heights moments parts pieces program "
        "project slips surface swaps weights"
    ).split(),
}
"""Files of each library, in any order. They are compiled as one, so that short functions of one are
inlined in others."""
FLAGS = ["-O3", "-g0", "-fno-math-errno", "-fno-trapping-math", "-fvisibility=hidden"]
MORE_FLAGS = "HYPERGAP_CFLAGS"
"""Environment variable with more flags, which compiler and linker get."""
DTYPES: dict[str, np.dtype] = {
    "int": np.dtype(np.int32),
    "int64_t": np.dtype(np.int64),
    "double": np.dtype(np.float64),
}

_kept: weakref.WeakKeyDictionary[Any, list] = weakref.WeakKeyDictionary()  # arrays by struct


def call(name: str, *args) -> Any:
    """Call a function of the C.

    Args:
        name: Its name.
        args: Numbers, structs, and C-contiguous arrays of the types that the header names; None for
            NULL. No array is converted or copied.

    Raises:
        TypeError: An argument doesn't match the header.
        RuntimeError: There is no C compiler that works.
    """
    return library(_owner(name)).call(name, args)


def struct(name: str, **fields) -> Any:
    """A pointer to a new struct of the C. Arrays that it points to live as long as it does.

    Args:
        name: Name of its type.
        fields: As for :func:`call`; structs and arrays in it as dictionaries and lists.

    Raises:
        TypeError: A field doesn't match the header.
    """
    return library(_owner(name)).new(f"{name} *", name, fields)


def changed(made: Any, name: str, **fields) -> Any:
    """A copy of a struct, a pointer to it, with other values of some fields; others stay shared.

    Args:
        made: From :func:`struct`.
        name: Name of its type.
        fields: As for :func:`struct`, of structs in it only what changes.

    Raises:
        TypeError: A field doesn't match the header.
    """
    return library(_owner(name)).changed(made, name, fields)


def structs(name: str, each: Iterable[dict[str, Any]]) -> Any:
    """Array of structs. Arrays that they point to live as long as it does."""
    return library(_owner(name)).new(f"{name}[]", name, list(each))


@cache
def dtype(name: str) -> np.dtype:
    """NumPy's dtype of a struct of the C without pointers."""
    found = library(_owner(name)).dtype(name)
    assert found is not None
    return found


def ints(array: npt.ArrayLike) -> npt.NDArray[np.int32]:
    """An array as C reads ``int``: C-contiguous, of int32; the same one if it is that."""
    return np.ascontiguousarray(array, dtype=np.int32)


def doubles(array: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """An array as C reads ``double``: C-contiguous, of float64; the same one if it is that."""
    return np.ascontiguousarray(array, dtype=np.float64)


class _Slot(NamedTuple):
    """A parameter of a function or a field of a struct."""

    name: str  # for messages
    ctype: Any
    kind: str  # kind of ctype
    array: Any  # array type of what a pointer points to, None if it is no pointer
    dtype: np.dtype | None  # of arrays that it may point to
    written: bool  # whether C may write there


class Library:
    """One of the libraries: ``lib`` has its functions, ``ffi`` their types."""

    def __init__(self, name: str):
        """Load it from the cache, or compile it first.

        Any number of processes may do so at once: each compiles in a folder of its own, and the
        file appears under its final name as a whole.

        Raises:
            RuntimeError: There is no C compiler that works.
        """
        module = _module(name)
        self.lib, self.ffi, self._text = module.lib, module.ffi, _declarations(name)
        self._slots: dict[str, dict[str, _Slot]] = {}

    def call(self, name: str, args) -> Any:
        """Call a function."""
        function = getattr(self.lib, name)
        kept: list = []
        slots = self._slots.get(name) or self._find_slots(name, self.ffi.typeof(function).args)
        if len(args) != len(slots):
            raise TypeError(f"{name} takes {len(slots)} arguments, not {len(args)}.")
        return function(*[self._given(*pair, kept) for pair in zip(slots.values(), args)])

    def new(self, cname: str, name: str, value) -> Any:
        """A struct, or structs, with their arrays."""
        kept: list = []
        if isinstance(value, list):
            given: Any = [self._fields(name, each, kept) for each in value]
        else:
            given = self._fields(name, value, kept)
        made = self.ffi.new(cname, given)
        _kept[made] = kept
        return made

    def changed(self, made, name: str, value: dict[str, Any]) -> Any:
        """A copy of a struct with other values of some fields."""
        copy = self.ffi.new(f"{name} *", made[0])
        _kept[copy] = kept = [made]
        self._set(copy, name, value, kept)
        return copy

    def _set(self, made, name: str, fields: dict[str, Any], kept: list):
        """Set fields of a struct, and of structs in it."""
        for key, value in fields.items():
            slot = self._slots_of(name)[key]
            if slot.kind == "array" and slot.ctype.item.kind == "struct":
                for part, each in zip(getattr(made, key), value, strict=True):
                    self._set(part, slot.ctype.item.cname, each, kept)
            else:
                setattr(made, key, self._given(slot, value, kept))

    def dtype(self, cname: str) -> np.dtype | None:
        """NumPy's dtype of a type; None of pointers, and of structs with pointers."""
        if cname in DTYPES:
            return DTYPES[cname]
        ctype = self.ffi.typeof(cname)
        if ctype.kind == "array":
            item = self.dtype(ctype.item.cname)
            return None if item is None else np.dtype((item, ctype.length))
        if ctype.kind != "struct":
            return None
        formats = [self.dtype(field.type.cname) for _, field in ctype.fields]
        if any(each is None for each in formats):  # float64 == None is true
            return None
        names, offsets = zip(*((key, field.offset) for key, field in ctype.fields), strict=True)
        size = self.ffi.sizeof(ctype)
        spec = {"names": names, "formats": formats, "offsets": offsets, "itemsize": size}
        return np.dtype(spec)  # type: ignore[call-overload]

    def _given(self, slot: _Slot, value, kept: list) -> Any:
        """An argument or a field for cffi.

        Args:
            slot: The parameter or the field.
            value: Its value.
            kept: Pointers to arrays are added; they must live as long as C uses them.
        """
        name, ctype, kind, array, dtype, written = slot
        if kind == "primitive":
            if isinstance(value, np.ndarray):
                raise TypeError(f"{name} is an array; it must be {ctype.cname}.")
            return value
        if kind == "array":
            slot = slot._replace(ctype=ctype.item, kind=ctype.item.kind)
            return [self._given(slot, each, kept) for each in value]
        if kind == "struct":
            return self._fields(ctype.cname, value, kept)
        if value is None:
            return self.ffi.NULL
        if dtype is None or not isinstance(value, np.ndarray):
            if isinstance(value, self.ffi.CData) and self.ffi.typeof(value).item is array.item:
                kept.append(value)
                return value
            wanted = ctype.cname if dtype is None else f"an array of {dtype}"
            raise TypeError(f"{name} is of {type(value)}; it must be {wanted}.")
        if value.dtype != dtype:
            raise TypeError(f"{name} is of {value.dtype}; it must be of {dtype}.")
        flags = value.flags
        if not flags.c_contiguous or (written and not flags.writeable):
            wanted = "writeable" if flags.c_contiguous else "C-contiguous"
            raise TypeError(f"{name} isn't {wanted}.")
        pointer = self.ffi.from_buffer(array, value)
        kept.append(pointer)
        return pointer

    def _fields(self, name: str, fields: dict[str, Any], kept: list) -> dict[str, Any]:
        """Fields of a struct for cffi."""
        slots = self._slots_of(name)
        return {key: self._given(slots[key], value, kept) for key, value in fields.items()}

    def _slots_of(self, name: str) -> dict[str, _Slot]:
        """The fields of a struct."""
        slots = self._slots.get(name)
        if slots is None:
            members = self.ffi.typeof(name).fields
            slots = self._find_slots(name, [field.type for _, field in members])
        return slots

    def _find_slots(self, name: str, ctypes) -> dict[str, _Slot]:
        """The parameters of a function or the fields of a struct, by their names in the header."""
        found = re.search(rf"\b{name}\(([^)]*)\);|\{{([^}}]*)\}} {name};", self._text)
        assert found is not None
        names: list[str] = []
        constant: list[bool] = []
        for part in re.split("[,;]", found[1] or found[2].strip().rstrip(";")):
            *words, own = re.findall(r"[A-Za-z_]\w*", part)
            names.append(own)
            # int *a, *b: the second one is like the first
            constant.append("const" in words if words else constant[-1])
        slots = self._slots[name] = {}
        for own, ctype, const in zip(names, ctypes, constant, strict=True):
            pointer = ctype.item if ctype.kind == "array" else ctype
            array = dtype = None
            if pointer.kind == "pointer":
                array = self.ffi.typeof(f"{pointer.item.cname}[]")
                dtype = self.dtype(pointer.item.cname)
            slots[own] = _Slot(f"{name}'s {own}", ctype, ctype.kind, array, dtype, not const)
        return slots


@cache
def library(name: str) -> Library:
    """A library: that of the plane, that of space, or that of matrices and walls for both.

    Raises:
        RuntimeError: There is no C compiler that works.
    """
    return Library(name)


@cache
def _owner(name: str) -> str:
    """The library that declares a function or a struct."""
    for own in HEADERS:
        if re.search(rf"\b{name}(\(|;)", _declarations(own)):
            return own
    raise NameError(f"no header in {FOLDER} declares {name}")


@cache
def _declarations(name: str) -> str:
    """A library's declarations for cffi: headers without comments, guards and includes."""
    text = "".join((FOLDER / header).read_text() for header in HEADERS[name])
    return re.sub(r"//.*|^#(?!define \w+ \d).*", "", text, flags=re.MULTILINE)


def _module(name: str):
    """A library as cffi makes it."""
    files = *sorted(FOLDER.glob("*.h")), *(FOLDER / f"{file}.c" for file in SOURCES[name])
    flags = FLAGS + os.environ.get(MORE_FLAGS, "").split()
    key = f"{cffi.__version__} {sys.version} {flags}", *(file.read_text() for file in files)
    digest = hashlib.sha256("\n".join(key).encode()).hexdigest()
    own = f"hypergap_{name}_{digest[:16]}"
    folder = Path(get_options()["cache_dir"])
    path = folder / (own + importlib.machinery.EXTENSION_SUFFIXES[0])
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        _compile(own, name, flags, path)
    spec = importlib.util.spec_from_file_location(own, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _compile(own: str, name: str, flags: list[str], path: Path):
    builder = cffi.FFI()
    builder.set_source(
        own,
        "".join(f'#include "{file}.c"\n' for file in SOURCES[name]),
        include_dirs=[str(FOLDER)],
        extra_compile_args=flags,
        extra_link_args=flags,
    )
    builder.cdef(_declarations(name))
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=own) as folder:
        try:
            built = builder.compile(tmpdir=folder)
        except Exception as error:  # setuptools' errors have no class in common
            raise RuntimeError(
                "3D interfaces and contact need a C compiler, as DOLFINx does, and it failed: "
                f"{error}"
            ) from error
        os.replace(built, path)
