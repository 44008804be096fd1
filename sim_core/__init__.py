"""Differentiable simulation of thin shells, soft gels and frictional contact. No ROS needed."""

import os

os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")  # keep standard output for results
