# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Off-screen rendering: in containers, on clusters, in CI."""

import os
import shutil
import subprocess
from ctypes.util import find_library

import vtkmodules.vtkRenderingOpenGL2 as opengl


def prepare():
    """Make VTK render off screen, in the way that its build supports.

    Raises:
        RuntimeError: VTK needs an X server, and there is neither one nor Xvfb.
    """
    if "DISPLAY" in os.environ:
        return
    if hasattr(opengl, "vtkEGLRenderWindow") and find_library("EGL"):
        # VTK would look for an X server first, and complain
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    elif hasattr(opengl, "vtkXOpenGLRenderWindow") and not hasattr(
        opengl, "vtkOSOpenGLRenderWindow"
    ):  # Debian's: it ends the process where it finds no X server
        os.environ["DISPLAY"] = _start_xvfb()


def _start_xvfb() -> str:
    """Start a virtual X server that ends with this process; returns its display."""
    if not shutil.which("Xvfb") or not shutil.which("setpriv"):
        raise RuntimeError(
            "no pictures without a screen: this VTK draws on an X server only. Install Xvfb "
            "(apt-get install xvfb), or set DISPLAY."
        )
    read, write = os.pipe()
    server = ("Xvfb", "-displayfd", str(write), "-screen", "0", "1280x1024x24")
    command = ("setpriv", "--pdeathsig", "TERM", *server, "-nolisten", "tcp")
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(command, pass_fds=(write,), stdout=quiet, stderr=quiet)
    os.close(write)
    with open(read) as pipe:
        number = pipe.readline().strip()  # when it is ready; nothing if it failed
    if not number:
        raise RuntimeError(f"no pictures: Xvfb ended with status {process.wait()}; set DISPLAY.")
    return f":{number}"
