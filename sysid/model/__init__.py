"""The forward model of a fit: recordings, parameters, nuisance parameters and predictions."""
