"""How far estimates can be trusted: profile likelihood, conflicts with priors, goodness of fit."""
