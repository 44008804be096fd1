"""Comparison of models of the same recordings: the ledger of a diagnosis, and posterior probabilities of models."""
