"""Error of mesh, time step and contact constants: measured by refinement, made small enough, and which of two
discretisations recordings follow."""
