"""Truths by other formulations than the simulator's, for the proof only.

A planar inextensible rod in its tangent angles (:mod:`rod`), a bonded layer by its response in wave-number space
(:mod:`layer`) and lumped robots and sensors (:mod:`sensors`). Nothing here uses the simulator, and nothing that
simulates, fits or diagnoses may import it.
"""
