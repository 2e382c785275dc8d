# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Makes the thumbnails beside it from the demos' pictures: ``python make.py``.

With complex scalars those of the demos that need them: ``python make.py complex``.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

FOLDER = Path(__file__).parent
PICTURES = {
    "assembly": ("assembly",),
    "contact_conductance": ("contact_conductance",),
    "contact_patch": ("contact_patch", "--quick"),
    "heat": ("heat",),
    "hyperelasticity": ("hyperelasticity",),
    "incompressible": ("incompressible",),
    "modal_analysis": ("mode_3",),
    "partial_overlap": ("gap_domain", "--cell", "mixed", "--degree", "1"),
    "patch_test": ("patch_test",),
    "patch_test_3d": ("patch_test_3d",),
    "peeling": ("peeling",),
    "periodic_cell": ("periodic_cell", "--fibres"),
    "pressurised_cylinder": ("gap_domain", "--degree", "2", "--levels", "1"),
    "pressurised_sphere": ("gap_domain", "--degree", "2", "--levels", "1"),
    "press_fit": ("press_fit",),
    "read_meshes": ("read_meshes",),
    "thermal_resistance": ("thermal_resistance", "--levels", "2"),
    "write_files": ("write_files",),
}
CHARTS = {
    "bearing": ("bearing",),
    "bolted_assembly": ("bolted_assembly",),
    "bouncing": ("bouncing",),
    "cad_assemblies": ("cad_assemblies",),
    "contact_run_time": (
        *("contact", "--scene", "contact", "--dims", "2", "--degrees", "1"),
        *("--sizes", "2,3,5,10", "--peers", "--repeats", "1"),
    ),
    "friction": ("friction", "--scene", "cattaneo"),
    "hertz": ("hertz",),
    "error_against_run_time": (
        *("cylinder", "--scene", "cylinder", "--degrees", "1,2,3"),
        *("--peers", "--repeats", "1"),
    ),
    "plasticity": ("plasticity",),
    "rolling": ("rolling",),
    "slender_contact": ("slender_contact",),
    "stability": ("stability",),
}
SCRIPTS = {"contact_run_time": "error_against_run_time"}  # others' are called as the picture
BESIDE = {"bolted_assembly": 2, "contact_run_time": 2}  # charts of other shapes
COMPLEX = {"wave": ("wave", "--degrees", "2")}
FILMS = {"ironing": ("ironing", "--steps", "40", "--step", "0.5", "--friction", "0.3")}


def thumbnail(picture: Path, file: Path):
    """Without what stands around the bodies: scale, text, white; a tall body lies on its side."""
    image = Image.open(picture).convert("RGB").crop((0, 40, 1020, 900))
    rows, columns = np.nonzero(np.asarray(image).min(axis=2) < 250)
    image = image.crop((columns.min(), rows.min(), columns.max() + 1, rows.max() + 1))
    if image.height > 3 * image.width:
        image = image.transpose(Image.Transpose.ROTATE_270)
    _save(image, file)


def first_chart(picture: Path, file: Path):
    """Of charts side by side the first."""
    image = Image.open(picture).convert("RGB")
    if file.stem in BESIDE or image.width > 2 * image.height:
        width = image.width / BESIDE[file.stem] if file.stem in BESIDE else 1.28 * image.height
        image = image.crop((0, 0, int(width), image.height))
    _save(image, file)


def film(picture: Path, file: Path):
    """A GIF of every second picture."""
    frames = []
    with Image.open(picture) as images:
        for k in range(0, images.n_frames, 2):
            images.seek(k)
            frame = images.convert("RGB").resize((560, 560 * images.height // images.width))
            frames.append(frame.quantize(96, Image.Quantize.FASTOCTREE))
    frames[0].save(file, save_all=True, append_images=frames[1:], duration=200, loop=0)


def _save(image, file: Path):
    image.thumbnail((400, 260), Image.Resampling.LANCZOS)
    image.quantize(128).save(file, optimize=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        wanted = COMPLEX if sys.argv[1:] == ["complex"] else PICTURES | CHARTS | FILMS
        for name, (picture, *arguments) in wanted.items():
            script = FOLDER.parent / f"{SCRIPTS.get(name, name)}.py"
            command = [sys.executable, script, *arguments, "--plot", temporary]
            subprocess.run(command, check=True, cwd=temporary)
            kind = "gif" if name in FILMS else "png"
            make = film if name in FILMS else first_chart if name in CHARTS else thumbnail
            make(Path(temporary) / f"{picture}.{kind}", FOLDER / f"{name}.{kind}")
