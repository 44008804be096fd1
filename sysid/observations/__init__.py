"""Readings of recordings and how they are matched to a rig."""
