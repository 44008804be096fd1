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
        "SSE only: the core, OpenBLAS, MKL and NumPy of a processor without AVX",
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
    "avx512": ("the core compiled for AVX-512", {}),
    "amd": (
        "OpenBLAS of AMD Zen, and MKL's code path that all processors share",
        {"OPENBLAS_CORETYPE": "Zen", "MKL_CBWR": "COMPATIBLE"},
    ),
    "reordered": ("the core compiled such that sums may be reordered and quotients be products", {}),
    "envelope": ("factorised within the envelope instead of by MKL PARDISO", {}),
    "one-ulp": ("nodes of sheets and gels at rest moved by one unit in the last place of their largest coordinate", {}),
}
FLAGS = {
    "sse": ("-march=x86-64",),
    "avx512": ("-march=x86-64-v4", "-mprefer-vector-width=512"),
    "reordered": (
        "-march=x86-64-v3", "-fassociative-math", "-freciprocal-math", "-fno-signed-zeros", "-fno-trapping-math",
    ),
}  # fmt: skip
"""By which the core and the laws of effects are compiled, where that is not as usual: into libraries of their own, of
which the core takes a minute the first time."""
DEFAULT = ["gradients", "contact", "energies", "solve", "bodies", "core", "scenes"]


NEEDED = {"sse": "sse2", "avx512": "avx512vl", "reordered": "avx2"}
"""What a processor has to have for that, as Linux calls it."""


def runs_here(name: str) -> bool:
    """Whether this processor has what the variation is compiled for."""
    known = Path("/proc/cpuinfo")
    return name not in NEEDED or (known.exists() and NEEDED[name] in known.read_text().split())


def vary() -> None:
    """Apply to this process what the environment cannot say; called before any test is collected."""
    name = os.environ.get(NAME)
    if name in FLAGS:
        from sim_core.core import build, pointwise

        build.target = pointwise.target = lambda: FLAGS[name]
    elif name == "envelope":
        from sim_core.core import pardiso

        pardiso.pymklpardiso = None
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
    wanted, failed = chosen.variation or [*VARIATIONS], []
    names = [name for name in wanted if runs_here(name)]
    for name in wanted:
        if name not in names:
            print(f"== {name} is not run: this processor has no {NEEDED[name]}", flush=True)
    for name in names:
        words, settings = VARIATIONS[name]
        environment = {**os.environ, **settings, NAME: name}
        print(f"== {name}: {words}", flush=True)
        command = [sys.executable, "-m", "pytest", *rest]
        if subprocess.run(command, cwd=ROOT, env=environment).returncode:
            failed.append(name)
    print(f"== {len(failed)} of {len(names)} variations failed: {', '.join(failed) or 'none'}")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
