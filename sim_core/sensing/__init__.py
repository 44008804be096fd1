"""What sensors and cameras of a rig report for a state of the scene."""
