"""Design of experiments: which motion determines which parameter."""
