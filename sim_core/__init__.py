"""Differentiable simulation of thin shells, soft gels and frictional contact. No ROS needed."""
