"""How fast this machine simulates, and how fast a recording is simulated with and without derivatives, as figures that
anyone can print again with ``thinshell bench``."""

from sysid.bench.effects import EffectSpeed, measure_effects, run_effects_benchmark
from sysid.bench.forming import Benchmark, measure, measure_side_by_side
from sysid.bench.gpu import GpuRun, measure_batch, run_gpu_benchmark
from sysid.bench.gradients import GradientBenchmark, measure_gradients, run_gradient_benchmark
from sysid.bench.recording import Speed, measure_recording, run_recording_benchmark
from sysid.bench.report import run_benchmarks
from sysid.bench.scale import Scaling, measure_scaling

__all__ = [
    "Benchmark",
    "EffectSpeed",
    "GpuRun",
    "GradientBenchmark",
    "Scaling",
    "Speed",
    "measure",
    "measure_batch",
    "measure_effects",
    "measure_gradients",
    "measure_recording",
    "measure_scaling",
    "measure_side_by_side",
    "run_benchmarks",
    "run_effects_benchmark",
    "run_gpu_benchmark",
    "run_gradient_benchmark",
    "run_recording_benchmark",
]
