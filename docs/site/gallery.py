"""Draws what each effect does to the readings of a rig (``make gallery``): the pictures of the catalogue of effects.

The rig is the first of a few on which the effect acts and shows above the noise. It is simulated without the effect and
with the sizes of its example, along the same motion; drawn is the column of readings that differs most in units of its
noise, and below it the difference. Arguments: names of effects; all of them without.
"""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

from sim_core.effects import Effect, all_effects, effect_by_name
from sim_core.errors import ThinshellError
from sim_core.rigs import Rig, load_rig
from sim_core.rigs.motion import load_experiment
from sysid.model.load import load_run
from sysid.model.predictor import SerialPredictor
from sysid.noise.estimate import as_declared
from sysid.observations.observations import Measured, Run
from sysid.simulate import simulate_to_bag

OUT = Path(__file__).resolve().parents[1] / "pictures" / "effects"
SHOWN_ON = (("strip_coarse", "pull_taut"), ("gel_sensor", "press_twist"), ("card_press", "press_post"))
"""Rigs and motions, the cheapest first."""
TELLING = 3.0
"""Difference over the noise from which no other rig is tried."""
SEEN = 1.0
"""Difference over the noise below which there is nothing to draw."""
COLOURS = 64


@dataclass
class Stage:
    """A rig along a motion without any effect: readings of its sensors without noise."""

    name: str
    rig: Rig
    run: Run
    engine: SerialPredictor
    readings: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Signature:
    """What an effect changes most: readings of one column without it and with it, over ``noise``, its standard
    deviation. ``largest``: of the difference over the noise."""

    stage: str
    measured: Measured
    column: int
    without: np.ndarray
    with_it: np.ndarray
    noise: float
    largest: float


def stage(rig_name: str, motion: str, folder: Path) -> Stage:
    """A rig along a motion."""
    rig = load_rig(rig_name)
    bag = folder / rig_name
    simulate_to_bag(rig, load_experiment(motion), bag, noise=lambda channel, kind, stamps, clean: np.zeros_like(clean))
    run, engine = load_run(rig, bag), SerialPredictor()
    return Stage(f"{rig_name}, {motion}", rig, run, engine, engine.predict(rig, run).values)


def signature(effect: Effect, on: Stage) -> Signature | None:
    """What an effect changes on a stage; None where it does not act there, or the rig cannot be simulated with it."""
    try:
        changed = on.rig.model_copy(update={"effects": {effect.name: dict(effect.example)}})
        found = on.engine.predict(changed, on.run).values
    except ThinshellError:
        return None
    best: Signature | None = None
    for m in on.run.measured:
        sigma = as_declared(on.rig, m).sigma
        away = np.nan_to_num(np.abs(found[m.channel] - on.readings[m.channel]) / sigma)
        column = int(np.argmax(away.max(axis=0)))
        largest = float(away[:, column].max())
        if best is None or largest > best.largest:
            best = Signature(
                on.name, m, column, on.readings[m.channel][:, column], found[m.channel][:, column],
                float(sigma[column]), largest,
            )  # fmt: skip
    return best


def draw(effect: Effect, shown: Signature, path: Path) -> None:
    """The picture of an effect."""
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    t = shown.measured.t
    figure, (above, below) = plt.subplots(
        2, sharex=True, figsize=(6.4, 3.6), height_ratios=(2, 1), layout="constrained"
    )
    above.plot(t, shown.without, color="0.55", lw=2.5, label="without it")
    above.plot(t, shown.with_it, color="C0", lw=1.2, label="with it")
    above.set(title=f"{effect.title} ({shown.stage})", ylabel=f"{shown.measured.channel} [{unit_of(shown)}]")
    above.title.set_fontsize(9)
    above.legend(fontsize=8)
    below.axhspan(-1.0, 1.0, color="0.9")
    below.plot(t, (shown.with_it - shown.without) / shown.noise, color="C3", lw=1.0)
    below.set(xlabel="time [s]", ylabel="difference\nover noise")
    written = io.BytesIO()
    figure.savefig(written, dpi=90)
    plt.close(figure)
    picture = Image.open(written).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    picture.save(path, optimize=True)


def unit_of(shown: Signature) -> str:
    """Unit of the column that is drawn."""
    if shown.measured.kind == "wrench":
        return "N" if shown.column < 3 else "N m"
    return "m" if shown.measured.kind == "markers" else "px"


def main(names: Sequence[str] = (), out: Path = OUT) -> int:
    """The pictures of some effects, or of all."""
    try:
        chosen = {effect.name: effect for effect in map(effect_by_name, names)} or dict(all_effects())
    except ThinshellError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    out.mkdir(parents=True, exist_ok=True)
    best: dict[str, Signature] = {}
    with tempfile.TemporaryDirectory() as folder:
        for rig, motion in SHOWN_ON:
            waiting = [e for n, e in chosen.items() if n not in best or best[n].largest < TELLING]
            if not waiting:
                break
            on = stage(rig, motion, Path(folder))
            for effect in waiting:
                found = signature(effect, on)
                if found is not None and (effect.name not in best or found.largest > best[effect.name].largest):
                    best[effect.name] = found
                    if found.largest >= SEEN:
                        draw(effect, found, out / f"{effect.name}.png")
                    print(f"{effect.name}: {found.largest:.3g} times the noise on {on.name}", flush=True)
    for name in chosen.keys() - best.keys():
        print(f"{name}: acts on none of the rigs", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
