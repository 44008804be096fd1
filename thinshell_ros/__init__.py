"""ROS 2 nodes over sim_core and sysid."""
