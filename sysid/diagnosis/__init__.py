"""Find the physics that a rig leaves out: detect, locate, name, model, show."""

from sysid.diagnosis.diagnose import diagnose_runs
from sysid.diagnosis.result import Diagnosis

__all__ = ["Diagnosis", "diagnose_runs"]
