"""From recordings to a folder of results with its report: what the command line and the node run."""

from sysid.workflow.diagnose import diagnose_bags
from sysid.workflow.fit import fit_bags

__all__ = ["diagnose_bags", "fit_bags"]
