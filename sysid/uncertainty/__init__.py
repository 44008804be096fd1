"""How far estimates can be believed: profile likelihood, conflicts with priors, goodness of fit."""
