"""Run tests as on another processor: other instruction sets, another factorisation, inputs moved by round-off.

    python tests/support/variations.py [-v NAME]... [ARGUMENTS OF PYTEST]

Without ``-v`` all variations are run one after another; without arguments, the tests that compare gradients, contact,
friction and solver results. A test that passes under one variation and fails under another balances on a branch, or on
round-off, and its cause or its case has to be mended.
"""

from __future__ import annotations

import argparse
import functools
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
NAME = "THINSHELL_TEST_VARIATION"
"""Environment variable that tells :func:`vary` which variation runs."""

NO_AVX512 = "X86_V4 AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR"
"""By the names of NumPy 2.4 (X86_V3 and X86_V4 are AVX2 and AVX-512) and of NumPy before; it ignores those it lacks."""

VARIATIONS: dict[str, tuple[str, dict[str, str]]] = {
    "sse": (
        "SSE only: OpenBLAS, MKL and NumPy of a processor without AVX",
        {
            "OPENBLAS_CORETYPE": "Prescott",
            "MKL_ENABLE_INSTRUCTIONS": "SSE4_2",
            "NPY_DISABLE_CPU_FEATURES": f"X86_V3 AVX2 FMA3 {NO_AVX512}",
        },
    ),
    "avx2": (
        "AVX2 without AVX-512: OpenBLAS, MKL and NumPy of an Intel processor of 2013 to 2016",
        {
            "OPENBLAS_CORETYPE": "Haswell",
            "MKL_ENABLE_INSTRUCTIONS": "AVX2",
            "NPY_DISABLE_CPU_FEATURES": NO_AVX512,
        },
    ),
    "amd": (
        "OpenBLAS of AMD Zen, and MKL's code path that all processors share",
        {"OPENBLAS_CORETYPE": "Zen", "MKL_CBWR": "COMPATIBLE"},
    ),
    "fast-math": ("Taichi's kernels compiled with fast_math, which reorders sums and contracts products", {}),
    "qdldl": ("factorised by qdldl instead of MKL PARDISO", {}),
    "one-ulp": ("nodes of sheets and gels at rest moved by one unit in the last place of their largest coordinate", {}),
}
DEFAULT = ["gradients", "contact", "energies", "solve", "bodies", "scenes"]


def vary() -> None:
    """Apply to this process what the environment cannot say; called before any test is collected."""
    name = os.environ.get(NAME)
    if name == "fast-math":
        import taichi as ti

        plain = ti.init

        @functools.wraps(plain)
        def init(*given: Any, **named: Any) -> Any:
            return plain(*given, **{**named, "fast_math": True})

        ti.init = init
    elif name == "qdldl":
        from sim_core.solve import factor

        factor.pymklpardiso = None
    elif name == "one-ulp":
        _move_nodes()


def _move_nodes() -> None:
    """Of sheets and gels, by the spacing of numbers at their largest coordinate."""
    import numpy as np

    from sim_core.rigs import Gel, Sheet
    from sim_core.scene import scene

    plain = scene.build_body

    @functools.wraps(plain)
    def build_body(*given: Any, **named: Any) -> Any:
        body = plain(*given, **named)
        if not isinstance(body.spec, Sheet | Gel):
            return body
        signs = np.random.default_rng(0).choice([-1.0, 1.0], body.rest.shape)
        move = signs * np.spacing(np.abs(body.rest).max())
        return replace(body, rest=body.rest + move, drawn=body.drawn + move)

    scene.build_body = build_body


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-v", "--variation", action="append", choices=VARIATIONS, help="run only this one")
    parser.add_argument("-l", "--list", action="store_true", help="list the variations")
    chosen, rest = parser.parse_known_args()
    if chosen.list:
        print("\n".join(f"{name:10} {words}" for name, (words, _) in VARIATIONS.items()))
        return 0
    rest = rest or ["-q", "-m", "not slow", *(f"tests/{room}" for room in DEFAULT)]
    failed = []
    for name in chosen.variation or VARIATIONS:
        words, settings = VARIATIONS[name]
        environment = {**os.environ, **settings, NAME: name}
        print(f"== {name}: {words}", flush=True)
        command = [sys.executable, "-m", "pytest", *rest]
        if subprocess.run(command, cwd=ROOT, env=environment).returncode:
            failed.append(name)
    print(f"== {len(failed)} of {len(chosen.variation or VARIATIONS)} variations failed: {', '.join(failed) or 'none'}")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
