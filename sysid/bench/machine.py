"""What the figures were measured on."""

from __future__ import annotations

import platform
import resource
import sys


def machine_name() -> str:
    """Model of the processor, or what the platform calls it."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            for line in lines:
                if line.lower().startswith("model name"):
                    return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def peak_memory_mb() -> float:
    """Most memory that this process has held so far [MB]."""
    try:
        with open("/proc/self/status", encoding="utf-8") as lines:  # getrusage would count the parent's as well
            for line in lines:
                if line.startswith("VmHWM:"):
                    return float(line.split()[1]) * 1024.0 / 1e6
    except OSError:
        pass
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
