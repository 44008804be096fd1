"""Makes cases with concealed physics. Nothing that diagnoses may import this package."""

from sysid.proof.generator.make import make_cases

__all__ = ["make_cases"]
