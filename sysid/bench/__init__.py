"""How fast a recording is simulated, with and without derivatives, as ``thinshell bench RIG BAG`` prints it."""

from sysid.bench.recording import Speed, measure_recording, run_recording_benchmark

__all__ = ["Speed", "measure_recording", "run_recording_benchmark"]
