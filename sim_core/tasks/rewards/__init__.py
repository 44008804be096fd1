"""Rewards, one module a kind, each with ``reward(seen) -> Scored``: a value and its derivatives."""
