"""Where MKL's supernodal factor PARDISO is, for compiled code, where its MIT-licensed wheel is installed."""

from __future__ import annotations

import ctypes
import os

os.environ.setdefault("MKL_NUM_THREADS", "1")  # one process a core is the parallelism

try:
    import pymklpardiso
except ImportError:  # no wheel for this platform
    pymklpardiso = None


def pardiso_address() -> int | None:
    """Address of MKL's ``pardiso_64`` in the library of the wheel, for compiled code; None where there is none."""
    if pymklpardiso is None:
        return None
    found = getattr(ctypes.CDLL(pymklpardiso._mkl_pardiso.__file__), "pardiso_64", None)
    return None if found is None else ctypes.cast(found, ctypes.c_void_p).value
