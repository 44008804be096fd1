"""Rollouts of sheets on a GPU, one thread block each (docs/design/gpu.md)."""
