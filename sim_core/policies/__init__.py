"""Policies that are learnt on tasks: one for a family of materials. Needs the extra ``policies``."""
