"""Ctrl-C while a command works: remembered where libraries swallow it, and answered with a word."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, current_thread, main_thread
from types import FrameType

_pressed = Event()
"""Ctrl-C was pressed while :func:`interrupts_remembered`."""


def raise_remembered() -> None:
    """Raise ``KeyboardInterrupt`` for one that was swallowed before."""
    if _pressed.is_set():
        raise KeyboardInterrupt


@contextmanager
def interrupts_remembered() -> Iterator[None]:
    """What swallows Ctrl-C in the block, as decorators of kernels do in imports, delays it until :func:`progress`."""
    try:
        with _answered(lambda: None, _pressed):
            yield
    finally:
        _pressed.clear()


@contextmanager
def interrupts_reported(words: str) -> Iterator[Event]:
    """Ctrl-C within the block is answered with ``words`` on stderr and sets the event, before it does anything. Pressed
    a second time, while what was found is written, it does nothing but that."""
    pressed = Event()
    with _answered(lambda: print(f"\n{words}", file=sys.stderr, flush=True), pressed, once=True):
        yield pressed


@contextmanager
def on_interrupt(act: Callable[[], None]) -> Iterator[None]:
    """Within the block Ctrl-C calls ``act`` before it does anything else, as to end what other threads do."""
    with _answered(act, Event()):
        yield


@contextmanager
def _answered(say: Callable[[], None], pressed: Event, once: bool = False) -> Iterator[None]:
    """Ctrl-C within the block sets the event and calls ``say`` before it does what it did; where it did nothing, or in
    a thread, it does nothing here. ``once``: pressed a second time it does not do what it did."""
    presses = 0
    before = signal.getsignal(signal.SIGINT)
    if not callable(before) or current_thread() is not main_thread():
        yield
        return

    def answered(number: int, frame: FrameType | None) -> None:
        nonlocal presses
        presses += 1
        pressed.set()
        with suppress(OSError, RuntimeError):  # nobody reads it any more, or it is being written to
            say()
        if not (once and presses == 2):
            before(number, frame)

    signal.signal(signal.SIGINT, answered)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
