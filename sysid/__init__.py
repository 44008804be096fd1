"""Identification from recordings: parameters, their uncertainty, and missing physics. No ROS needed."""
