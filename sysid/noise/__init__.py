"""Noise of recorded channels: level, autocorrelation, quantisation, and data quality."""
