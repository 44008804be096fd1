"""Fit the parameters of a rig to recordings, with intervals and held-out scores."""

from sysid.fit.fit import fit_runs
from sysid.fit.options import FitOptions
from sysid.fit.result import FitResult

__all__ = ["FitOptions", "FitResult", "fit_runs"]
