"""Pictures, animations and a page of any rig, experiment, recording or trace: the functions behind ``thinshell show``.

It is a room of ``sysid`` because it reads recordings and draws with matplotlib, which ``sim_core`` does without; what
it draws (surfaces, strain, curvature, pressure, slip) comes from :mod:`sim_core.postprocess`, the words of what looks
wrong from :mod:`sim_core.preflight`.
"""

from sysid.show.outputs import show
from sysid.show.subject import Subject, subject_of

__all__ = ["Subject", "show", "subject_of"]
