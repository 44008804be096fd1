"""Estimation: residuals, Gauss-Newton, trust region, variable projection, outliers, covariance."""
