"""Find the physics that a rig leaves out: detect, locate, name, model, show."""

from sysid.mismatch.diagnose import diagnose_bags, diagnose_runs
from sysid.mismatch.result import Diagnosis

__all__ = ["Diagnosis", "diagnose_bags", "diagnose_runs"]
