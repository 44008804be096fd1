"""Find the physics that a rig leaves out: detect, locate, name, model, show."""
