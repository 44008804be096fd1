"""How fast this machine simulates, as figures anyone can print again with ``thinshell bench``."""

from sim_core.bench.forming import Benchmark, measure, measure_side_by_side
from sim_core.bench.gradients import GradientBenchmark, measure_gradients, run_gradient_benchmark
from sim_core.bench.report import run_benchmarks
from sim_core.bench.scale import Scaling, measure_scaling

__all__ = [
    "Benchmark",
    "GradientBenchmark",
    "Scaling",
    "measure",
    "measure_gradients",
    "measure_scaling",
    "measure_side_by_side",
    "run_benchmarks",
    "run_gradient_benchmark",
]
