"""Guarded replay of a trajectory on whatever follows poses. No ROS but in :mod:`thinshell_ros.replay.messages`."""
