"""What ends a part of a fit before its time, and leaves what was found before."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from sim_core.errors import ThinshellError
from sysid.solve.optimum import Fitted

ENDS_EARLY = (KeyboardInterrupt, ThinshellError)
"""Ctrl-C, and what cannot be simulated."""


def reason_of(error: BaseException) -> str:
    """The error in words."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted."
    return str(error) if isinstance(error, ThinshellError) else f"{type(error).__name__}: {error}"


def end_unconverged(fitted: Fitted, error: BaseException, left: str) -> None:
    """Let a fit stand at what was found, as not converged. ``left``: what was not done for the error, in words."""
    if isinstance(error, KeyboardInterrupt):
        fitted.interrupt()
        fitted.message += f"; {left}"
    else:
        fitted.converged, fitted.message = False, f"{left}. {reason_of(error)}"


@contextmanager
def interrupts_ignored() -> Iterator[None]:
    """Ctrl-C does nothing within the block, in which what was found is put together: seconds in which all of it would
    be lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
