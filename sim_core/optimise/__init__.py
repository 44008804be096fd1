"""Optimisation of motions for tasks: methods behind one interface, budgets, runs that go on."""

from sim_core.optimise.methods import METHODS, Method, method
from sim_core.optimise.problem import Budget, BudgetSpent, Evaluation, Problem
from sim_core.optimise.run import Result, Settings, optimise

__all__ = [
    "METHODS",
    "Budget",
    "BudgetSpent",
    "Evaluation",
    "Method",
    "Problem",
    "Result",
    "Settings",
    "method",
    "optimise",
]
